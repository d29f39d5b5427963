// SPDX-License-Identifier: Apache-2.0
#include "perception/direct_template.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/LU>
#include <opencv2/imgproc.hpp>

namespace holdfast::perception {
namespace {

constexpr int kMargin = 3;             // the gradient needs one pixel, sampling three
constexpr double kPlaneReach = 1.5;    // the plane is fitted over this many patch half-widths
constexpr std::size_t kAttempts = 16;  // candidates of a cell that are looked at

void subtract_mean(float* values) {
  float sum = 0;
  for (int k = 0; k < kPatchCount; ++k) sum += values[k];
  for (int k = 0; k < kPatchCount; ++k) values[k] -= sum / kPatchCount;
}

float dot(const float* a, const float* b) {
  float sum = 0;
  for (int k = 0; k < kPatchCount; ++k) sum += a[k] * b[k];
  return sum;
}

void project_out(float* values, const float* direction, float squares) {
  const float share = dot(values, direction) / squares;
  for (int k = 0; k < kPatchCount; ++k) values[k] -= share * direction[k];
}

/// One level of the keyframe while its patches are chosen.
class LevelBuilder {
 public:
  LevelBuilder(const Pyramid& keyframe, int level, const cv::Mat& dropped_sums,
               const CameraModel& camera, const Site& site, double texture_min)
      : image_(keyframe.levels[static_cast<std::size_t>(level)]),
        dropped_sums_(dropped_sums),
        camera_(camera),
        site_(site),
        scale_(std::ldexp(1.0, level)),
        texture_min_(texture_min) {
    cv::cornerMinEigenVal(image_, score_, kPatchSide - 1);
  }

  TemplateLevel build(int wanted, bool is_weakest = false);

 private:
  void rank(cv::Rect cell, bool is_weakest);
  void add_first(TemplateLevel& out);
  [[nodiscard]] bool is_kept(cv::Point corner) const;
  [[nodiscard]] bool place(cv::Point corner, PatchGeometry& geometry) const;

  const cv::Mat& image_;
  const cv::Mat& dropped_sums_;  // integral image of what is not kept, of half size
  const CameraModel& camera_;
  const Site& site_;
  double scale_, texture_min_;
  cv::Mat score_;
  std::vector<std::pair<float, cv::Point>> candidates_;
};

TemplateLevel LevelBuilder::build(int wanted, bool is_weakest) {
  TemplateLevel out;
  const int reach = kMargin + kPatchSide;
  if (image_.cols <= 2 * reach || image_.rows <= 2 * reach) return out;
  const double area = static_cast<double>(image_.cols) * image_.rows;
  const int cell = std::max(kPatchSide, static_cast<int>(std::sqrt(area / wanted)));
  const cv::Rect inside(kMargin, kMargin, image_.cols - reach - kMargin,
                        image_.rows - reach - kMargin);
  for (int y = inside.y; y < inside.br().y; y += cell)
    for (int x = inside.x; x < inside.br().x; x += cell) {
      rank(cv::Rect(x, y, cell, cell) & inside, is_weakest);
      add_first(out);
    }
  return out;
}

/// The candidates of a cell that are looked at, in order: those of most texture, or those of the
/// least that is clearly enough. `cell` holds first pixels of patches.
void LevelBuilder::rank(cv::Rect cell, bool is_weakest) {
  // cv::cornerMinEigenVal scales its derivatives, and sums over 7x7.
  constexpr double kScale = 1.0 / (4 * (kPatchSide - 1) * 255) * 8;
  constexpr double kArea = 49.0 / kPatchCount;
  const auto enough = static_cast<float>(2 * texture_min_ * kScale * kScale * kArea);
  candidates_.clear();
  for (int y = cell.y; y < cell.br().y; y += 2)
    for (int x = cell.x; x < cell.br().x; x += 2) {
      const float score = score_.at<float>(y + kPatchSide / 2, x + kPatchSide / 2);
      if (is_weakest && score < enough) continue;
      candidates_.emplace_back(is_weakest ? -score : score, cv::Point(x, y));
    }
  const std::size_t n = std::min(kAttempts, candidates_.size());
  std::partial_sort(candidates_.begin(), candidates_.begin() + static_cast<std::ptrdiff_t>(n),
                    candidates_.end(), [](const auto& a, const auto& b) {
                      if (a.first != b.first) return a.first > b.first;
                      return a.second.y != b.second.y ? a.second.y < b.second.y
                                                      : a.second.x < b.second.x;
                    });
  candidates_.resize(n);
}

void LevelBuilder::add_first(TemplateLevel& out) {
  PatchPixels pixels;
  PatchGeometry geometry;
  for (const auto& [score, corner] : candidates_) {
    if (!is_kept(corner) || !cut_patch(image_, corner, texture_min_, pixels, geometry) ||
        !place(corner, geometry))
      continue;
    out.pixels.push_back(pixels);
    out.geometry.push_back(geometry);
    return;
  }
}

bool LevelBuilder::is_kept(cv::Point corner) const {
  const double to_half = scale_ / 2;
  const auto at = [&](int v, int most) {
    return std::clamp(static_cast<int>(std::lround(v * to_half)), 0, most);
  };
  const int x0 = at(corner.x - 1, dropped_sums_.cols - 1),
            x1 = at(corner.x + kPatchSide + 1, dropped_sums_.cols - 1);
  const int y0 = at(corner.y - 1, dropped_sums_.rows - 1),
            y1 = at(corner.y + kPatchSide + 1, dropped_sums_.rows - 1);
  return dropped_sums_.at<int>(y1, x1) - dropped_sums_.at<int>(y0, x1) -
             dropped_sums_.at<int>(y1, x0) + dropped_sums_.at<int>(y0, x0) ==
         0;
}

bool LevelBuilder::place(cv::Point corner, PatchGeometry& geometry) const {
  constexpr double kHalf = 0.5 * (kPatchSide - 1);
  const auto full = [&](double v) { return (v + 0.5) * scale_ - 0.5; };
  const double x = corner.x + kHalf, y = corner.y + kHalf;
  const auto rays = to_normalised(camera_, {{full(x), full(y)},
                                            {full(x + 1), full(y)},
                                            {full(x - 1), full(y)},
                                            {full(x), full(y + 1)},
                                            {full(x), full(y - 1)}});
  const Eigen::Vector2d ray(rays[0].x, rays[0].y);
  const double reach = kPlaneReach * kHalf * scale_ / camera_.f_px();
  const auto plane = site_.plane_near(ray, reach);
  if (!plane) return false;
  const auto on_plane = [&](const cv::Point2d& r) -> Eigen::Vector3d {
    const Eigen::Vector3d direction(r.x, r.y, 1);
    return direction / plane->dot(direction);
  };
  geometry.p_site_mm = on_plane(rays[0]);
  geometry.tangents_mm.col(0) = 0.5 * (on_plane(rays[1]) - on_plane(rays[2]));
  geometry.tangents_mm.col(1) = 0.5 * (on_plane(rays[3]) - on_plane(rays[4]));
  return geometry.p_site_mm.allFinite() && geometry.tangents_mm.allFinite() &&
         geometry.p_site_mm.z() > 0;
}

}  // namespace

bool cut_patch(const cv::Mat& image, cv::Point corner, double texture_min, PatchPixels& pixels,
               PatchGeometry& geometry) {
  const auto step = static_cast<std::ptrdiff_t>(image.step1());
  float sum = 0;
  int k = 0;
  for (int j = 0; j < kPatchSide; ++j) {
    const uchar* row = image.ptr(corner.y + j) + corner.x;
    for (int i = 0; i < kPatchSide; ++i, ++k) {
      pixels.value[k] = static_cast<float>(row[i]);
      sum += pixels.value[k];
      pixels.gx[k] = 0.5F * static_cast<float>(row[i + 1] - row[i - 1]);
      pixels.gy[k] = 0.5F * static_cast<float>(row[i + step] - row[i - step]);
    }
  }
  geometry.mean = sum / kPatchCount;
  for (float* values : {pixels.value, pixels.gx, pixels.gy}) subtract_mean(values);
  geometry.squares = dot(pixels.value, pixels.value);
  if (!(geometry.squares > 0)) return false;
  project_out(pixels.gx, pixels.value, geometry.squares);
  project_out(pixels.gy, pixels.value, geometry.squares);
  const auto xx = static_cast<double>(dot(pixels.gx, pixels.gx));
  const auto xy = static_cast<double>(dot(pixels.gx, pixels.gy));
  const auto yy = static_cast<double>(dot(pixels.gy, pixels.gy));
  geometry.information << xx, xy, xy, yy;
  const double smaller = 0.5 * (xx + yy) - std::hypot(0.5 * (xx - yy), xy);
  if (!(smaller >= texture_min)) return false;
  geometry.unit_covariance_px2 = geometry.information.inverse();
  return true;
}

DirectTemplate make_template(const Pyramid& keyframe, const cv::Mat& keep_half,
                             const CameraModel& camera, const Site& site,
                             const DirectParameters& parameters) {
  cv::Mat dropped_sums;
  cv::integral((keep_half == 0) / 255, dropped_sums, CV_32S);
  DirectTemplate out;
  for (int level = 0; level < kPyramidLevels; ++level) {
    const int wanted = level == 0 ? parameters.patches : std::max(parameters.patches / 4, 1);
    LevelBuilder builder(keyframe, level, dropped_sums, camera, site, parameters.texture_min);
    out[static_cast<std::size_t>(level)] = builder.build(wanted);
  }
  return out;
}

TemplateLevel make_witnesses(const Pyramid& keyframe, const cv::Mat& keep_half,
                             const CameraModel& camera, const Site& site,
                             const DirectParameters& parameters) {
  cv::Mat dropped_sums;
  cv::integral((keep_half == 0) / 255, dropped_sums, CV_32S);
  LevelBuilder builder(keyframe, 0, dropped_sums, camera, site, parameters.texture_min);
  return builder.build(parameters.witnesses, true);
}

}  // namespace holdfast::perception
