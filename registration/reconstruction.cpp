// SPDX-License-Identifier: Apache-2.0
#include "registration/reconstruction.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include <fmt/format.h>
#include <opencv2/imgproc.hpp>

#include "registration/pattern_lattice.hpp"
#include "registration/stereo_checks.hpp"
#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

using Clock = std::chrono::steady_clock;
using Status = ReconstructionStatus;

constexpr double kDarkestGrey = 12;          // the 99th percentile must be above
constexpr double kSaturatedShareMax = 0.25;  // of the image
constexpr double kTexturedShareMin = 0.15;   // of the blocks
constexpr int kShotsMax = 31;

bool has_format(const cv::Mat& image, cv::Size size) {
  return image.size() == size && (image.depth() == CV_8U || image.depth() == CV_16U) &&
         (image.channels() == 1 || image.channels() == 3);
}

struct Finding {
  Status status = Status::done;
  std::string evidence;
};

Finding judge_exposure(const cv::Mat1b& image, const char* which) {
  const Exposure exposure = exposure_of(image);
  if (exposure.bright_grey < kDarkestGrey)
    return {Status::too_dark,
            fmt::format("99 % of the {} image is below {:.0f} of 255, must reach {:.0f}", which,
                        exposure.bright_grey + 1, kDarkestGrey)};
  if (exposure.saturated_share > kSaturatedShareMax)
    return {Status::saturated,
            fmt::format("{:.0f} % of the {} image is saturated, limit {:.0f} %",
                        100 * exposure.saturated_share, which, 100 * kSaturatedShareMax)};
  if (exposure.textured_share < kTexturedShareMin)
    return {Status::no_pattern,
            fmt::format("{:.0f} % of the {} image shows texture, must be {:.0f} %: is the pattern "
                        "projected and in focus?",
                        100 * exposure.textured_share, which, 100 * kTexturedShareMin)};
  return {};
}

DisparityRange range_around(const Rectification& geometry, double centre_mm, double reach_mm) {
  const int least = static_cast<int>(std::floor(geometry.disparity_px(centre_mm + reach_mm)));
  const int most = static_cast<int>(std::ceil(geometry.disparity_px(centre_mm - reach_mm)));
  return {least, most - least + 1};
}

}  // namespace

std::string_view name(ReconstructionStatus status) noexcept {
  switch (status) {
    case Status::done:
      return "done";
    case Status::wrong_size:
      return "wrong image size";
    case Status::too_dark:
      return "too dark";
    case Status::saturated:
      return "saturated";
    case Status::no_pattern:
      return "no pattern";
    case Status::views_swapped:
      return "left and right swapped";
    case Status::wrong_optics:
      return "wrong zoom or calibration";
    case Status::lattice:
      return "the pattern is a lattice";
    case Status::period_slip:
      return "pattern period slip";
    case Status::no_surface:
      break;
  }
  return "no surface";
}

struct Reconstructor::Impl {
  ZoomCalibration zoom;
  cv::Size image_px;
  ReconstructionOptions options;
  MatchParameters match;
  Rectification geometry;
  cv::Rect region;  // what is asked for
  DisparityRange range;
  std::unique_ptr<Rectifier> left, right;
  WorkerPool pool;
  std::vector<RectifiedPair> pairs;

  Impl(const ZoomCalibration& calibration, cv::Size size, const ReconstructionOptions& wanted)
      : zoom(calibration),
        image_px(size),
        options(wanted),
        match(wanted.match.value_or(match_parameters_for(size))),
        geometry(rectification_of(calibration, size)),
        pool(std::clamp(wanted.threads, 1, 64)) {
    if (wanted.method == MatchMethod::opencv) match.method = MatchMethod::opencv;
    match.is_explained = wanted.is_explained;
    const double centre = wanted.depth_centre_mm > 0 ? wanted.depth_centre_mm : zoom.focus_mm;
    if (!(wanted.depth_reach_mm > 0) || !(centre - wanted.depth_reach_mm > 0))
      throw InputError(
          fmt::format("working depth of {} mm +- {} mm must lie in front of the camera", centre,
                      wanted.depth_reach_mm));
    range = whole_range(match, range_around(geometry, centre, wanted.depth_reach_mm));
    const cv::Rect whole({}, size), roi = wanted.roi_px.value_or(whole);
    if (roi.width < 32 || roi.height < 32 || (roi & whole) != roi)
      throw InputError(
          fmt::format("region {},{},{},{} must be at least 32x32 px and within {}x{} px", roi.x,
                      roi.y, roi.width, roi.height, size.width, size.height));
    region = wanted.is_rectified ? roi : rectified_region(zoom, geometry, roi);
    if (region.empty()) throw InputError("the region is not in view of the rectified left camera");
    prepare();
  }

  [[nodiscard]] cv::Rect padded() const { return {region.tl(), padded_size(match, region.size())}; }
  [[nodiscard]] int largest_px() const { return range.minimum_px + range.count - 1; }
  [[nodiscard]] cv::Rect padded_right() const {
    const cv::Rect area = padded();
    return {area.x - largest_px(), area.y, area.width + range.count, area.height};
  }

  void prepare() {
    if (options.is_rectified) {  // a camera without distortion whose matrix is P
      const cv::Matx33d none = cv::Matx33d::eye();
      left = std::make_unique<Rectifier>(geometry.P1.get_minor<3, 3>(0, 0), cv::Mat(), none,
                                         geometry.P1, image_px, padded());
      right = std::make_unique<Rectifier>(geometry.P2.get_minor<3, 3>(0, 0), cv::Mat(), none,
                                          geometry.P2, image_px, padded_right());
      return;
    }
    left = std::make_unique<Rectifier>(zoom.camera_matrix_left, zoom.distortion_left, geometry.R1,
                                       geometry.P1, image_px, padded());
    right = std::make_unique<Rectifier>(zoom.camera_matrix_right, zoom.distortion_right,
                                        geometry.R2, geometry.P2, image_px, padded_right());
  }

  void rectify(std::span<const StereoShot> shots) {
    pairs.resize(shots.size());
    for (std::size_t i = 0; i < shots.size(); ++i) {
      left->apply(grey_of(shots[i].left), pool, pairs[i].left);
      right->apply(grey_of(shots[i].right), pool, pairs[i].right);
    }
  }

  Finding judge_input(std::span<const StereoShot> shots) const;
  Finding judge_pattern(std::span<const StereoShot> shots, Reconstruction& result);
  Finding judge_result(const DisparityMap& map, std::span<const StereoShot> shots,
                       Reconstruction& result);
  [[nodiscard]] bool is_swapped(std::span<const StereoShot> shots, double density) const;
  void reproject(const DisparityMap& map, Reconstruction& result);
  void reproject_row(const DisparityMap& map, int y, Reconstruction& result) const;
};

Finding Reconstructor::Impl::judge_input(std::span<const StereoShot> shots) const {
  if (shots.empty() || shots.size() > kShotsMax)
    return {Status::wrong_size, fmt::format("{} shots, must be 1 … {}", shots.size(), kShotsMax)};
  for (const StereoShot& shot : shots)
    for (const cv::Mat* image : {&shot.left, &shot.right})
      if (!has_format(*image, image_px))
        return {
            Status::wrong_size,
            fmt::format("an image is {}x{} px with {} channels of type {}, must be {}x{} px, grey "
                        "or colour, 8 or 16 bits",
                        image->cols, image->rows, image->channels(), image->depth(), image_px.width,
                        image_px.height)};
  return {};
}

/// On the whole left image, whatever the region: more of the pattern is seen there.
Finding Reconstructor::Impl::judge_pattern(std::span<const StereoShot> shots,
                                           Reconstruction& result) {
  ImageRepetition worst;
  for (const StereoShot& shot : shots)
    if (const ImageRepetition found = repetition_of(grey_of(shot.left), pool);
        found.share > worst.share)
      worst = found;
  result.image_repetition = worst.share;
  if (worst.share <= kRepetitionMax) return {};
  result.is_for_comparison = options.may_be_lattice;
  if (options.may_be_lattice) return {};
  return {Status::lattice,
          fmt::format("{:.2f} of the image's texture comes again {:.0f},{:.0f} px further, limit "
                      "{:.2f}: it can slip by that period",
                      worst.share, worst.step_px.x, worst.step_px.y, kRepetitionMax)};
}

/// Would the views fit the other way round? Only asked when they do not fit as they are.
bool Reconstructor::Impl::is_swapped(std::span<const StereoShot> shots, double density) const {
  ReconstructionOptions other = options;
  other.method = MatchMethod::sgm;
  other.density_min = 0;
  other.ambiguous_share_max = 1;
  other.may_be_lattice = true;
  other.vertical_limit_px = 1e9;  // no further question
  Reconstructor swapped(zoom, image_px, other);
  const StereoShot shot{shots[0].right, shots[0].left};
  const Reconstruction result = swapped.reconstruct(std::span(&shot, 1));
  return result.density > density && result.vertical_disparity_px < options.vertical_limit_px &&
         result.density > options.density_min;
}

Finding Reconstructor::Impl::judge_result(const DisparityMap& map,
                                          std::span<const StereoShot> shots,
                                          Reconstruction& result) {
  const VerticalDisparity vertical = vertical_disparity(pairs[0], map.disparity_px, largest_px());
  result.vertical_disparity_px = vertical.rms_px;
  result.ambiguous_share = map.ambiguous_share;
  const bool is_sparse = !(result.density >= options.density_min);
  const bool is_off_rows = vertical.rms_px > options.vertical_limit_px;
  if ((is_sparse || is_off_rows) && !options.is_rectified && is_swapped(shots, result.density))
    return {Status::views_swapped, "the views fit only when exchanged"};
  if (is_off_rows)
    return {
        Status::wrong_optics,
        fmt::format("matched points lie {:.2f} px off their rows, limit {:.2f} px: another zoom "
                    "or another rig's calibration?",
                    vertical.rms_px, options.vertical_limit_px)};
  if (map.ambiguous_share > options.ambiguous_share_max)
    return {Status::period_slip,
            fmt::format("{:.0f} % of the scene fits nearly as well elsewhere on its rows, limit "
                        "{:.0f} %: the pattern repeats",
                        100 * map.ambiguous_share, 100 * options.ambiguous_share_max)};
  if (is_sparse)
    return {Status::no_surface,
            fmt::format("{:.1f} % of the region could be matched, must be {:.0f} %",
                        100 * result.density, 100 * options.density_min)};
  return {};
}

void Reconstructor::Impl::reproject_row(const DisparityMap& map, int y,
                                        Reconstruction& result) const {
  const auto fb = static_cast<float>(geometry.focal_px() * geometry.baseline_mm());
  const auto shift = static_cast<float>(geometry.P2(0, 2) - geometry.P1(0, 2));
  const auto per_fx = static_cast<float>(1 / geometry.P1(0, 0));
  const auto ray_y = static_cast<float>((region.y + y - geometry.P1(1, 2)) / geometry.P1(1, 1));
  const auto x0 = static_cast<float>(region.x - geometry.P1(0, 2));
  const float *const disparity = map.disparity_px[y], *const variance = map.variance_px2[y];
  float *const depth = result.depth_mm[y], *const depth_variance = result.depth_variance_mm2[y];
  auto* const point = reinterpret_cast<float*>(result.points_mm[y]);
  for (int x = 0; x < region.width; ++x) {
    const float z = fb / (disparity[x] + shift);
    const float slope = z * z / fb;  // mm per px
    depth[x] = z;
    depth_variance[x] = variance[x] * slope * slope;
    point[3 * x] = (x0 + static_cast<float>(x)) * per_fx * z;
    point[3 * x + 1] = ray_y * z;
    point[3 * x + 2] = z;
  }
}

void Reconstructor::Impl::reproject(const DisparityMap& map, Reconstruction& result) {
  constexpr int kRowsPerTask = 32;
  result.region_px = region;
  const cv::Rect part({}, region.size());
  result.disparity_px = map.disparity_px(part);
  result.confidence = map.confidence(part);
  result.depth_mm.create(region.size());
  result.depth_variance_mm2.create(region.size());
  result.points_mm.create(region.size());
  std::vector<std::size_t> known(static_cast<std::size_t>(region.height));
  pool.run((region.height + kRowsPerTask - 1) / kRowsPerTask, [&](int task) {
    const int end = std::min((task + 1) * kRowsPerTask, region.height);
    for (int y = task * kRowsPerTask; y < end; ++y) {
      reproject_row(map, y, result);
      const float* const depth = result.depth_mm[y];
      known[static_cast<std::size_t>(y)] = static_cast<std::size_t>(
          std::count_if(depth, depth + region.width, [](float z) { return z == z; }));
    }
  });
  for (const std::size_t n : known) result.points += n;
  if (!map.reasons.empty()) result.reasons = map.reasons(cv::Rect({}, region.size())).clone();
  constexpr double kEndlessMm = 1e6;
  const double farthest = geometry.depth_mm(range.minimum_px);
  result.nearest_mm = geometry.depth_mm(largest_px());
  result.farthest_mm = farthest > 0 && std::isfinite(farthest) ? farthest : kEndlessMm;
  result.density = static_cast<double>(result.points) / region.area();
}

Reconstructor::Reconstructor(const ZoomCalibration& zoom, cv::Size image_px,
                             const ReconstructionOptions& options)
    : impl_(std::make_unique<Impl>(zoom, image_px, options)) {}
Reconstructor::~Reconstructor() = default;

const Rectification& Reconstructor::rectification() const {
  return impl_->geometry;
}

Reconstruction Reconstructor::reconstruct(std::span<const StereoShot> shots) {
  Reconstruction result;
  const auto conclude = [&result](Finding finding) {
    result.status = finding.status;
    result.evidence = std::move(finding.evidence);
    return finding.status != Status::done;
  };
  const auto start = Clock::now();
  if (conclude(impl_->judge_input(shots))) return result;
  impl_->rectify(shots);
  for (const RectifiedPair& pair : impl_->pairs)
    if (conclude(judge_exposure(pair.left.pixels, "left")) ||
        conclude(judge_exposure(pair.right.pixels, "right")))
      return result;
  if (conclude(impl_->judge_pattern(shots, result))) return result;
  const auto rectified = Clock::now();
  const DisparityMap map = match_disparity(impl_->pairs, impl_->range, impl_->match, impl_->pool);
  const auto matched = Clock::now();
  impl_->reproject(map, result);
  const bool is_refused = conclude(impl_->judge_result(map, shots, result));
  result.times = {rectified - start, map.match_time, map.refine_time, Clock::now() - matched,
                  Clock::now() - start};
  if (is_refused) {
    result.disparity_px.release();
    result.depth_mm.release();
    result.depth_variance_mm2.release();
    result.confidence.release();
    result.points_mm.release();
    result.reasons.release();
  }
  return result;
}

}  // namespace holdfast::registration
