// SPDX-License-Identifier: Apache-2.0
#include "registration/pattern_refinement.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include <opencv2/imgproc.hpp>

#include "registration/pixel_reason.hpp"

namespace holdfast::registration {
namespace {

constexpr int kStepPx = 4;     // of the camera's pixels that are asked
constexpr int kWindowPx = 24;  // of the pattern and, scaled, of the image: what a match looks at
constexpr int kSaturated = 250;

/// Depths everywhere, on a coarse grid: unknown ones from around, only to aim by.
cv::Mat1f guessed_depths(const Reconstruction& surface) {
  cv::Mat1f sum, weight;
  cv::Mat1b known(surface.depth_mm.size());
  for (int y = 0; y < known.rows; ++y)
    for (int x = 0; x < known.cols; ++x)
      known(y, x) = std::isnan(surface.depth_mm(y, x)) ? uchar{0} : uchar{1};
  cv::Mat1f depth = surface.depth_mm.clone();
  depth.setTo(0, known == 0);
  cv::resize(depth, sum, {}, 1.0 / kStepPx, 1.0 / kStepPx, cv::INTER_AREA);
  cv::Mat1f mask;
  known.convertTo(mask, CV_32F);
  cv::resize(mask, weight, {}, 1.0 / kStepPx, 1.0 / kStepPx, cv::INTER_AREA);
  cv::Mat1f guessed(sum.size(), 0.F);
  // Wider and wider, until nothing is left unknown.
  for (int reach = 3; reach < 4 * std::max(sum.rows, sum.cols); reach = 2 * reach + 1) {
    cv::Mat1f s, w;
    cv::boxFilter(sum, s, -1, {reach, reach}, {-1, -1}, false, cv::BORDER_CONSTANT);
    cv::boxFilter(weight, w, -1, {reach, reach}, {-1, -1}, false, cv::BORDER_CONSTANT);
    int open = 0;
    for (int y = 0; y < sum.rows; ++y)
      for (int x = 0; x < sum.cols; ++x) {
        if (guessed(y, x) > 0) continue;
        if (weight(y, x) > 0.5F)
          guessed(y, x) = sum(y, x) / weight(y, x);
        else if (w(y, x) > 0.5F)
          guessed(y, x) = s(y, x) / w(y, x);
        else
          ++open;
      }
    if (open == 0) break;
  }
  return guessed;
}

/// Standard deviation in windows.
cv::Mat1f contrast_of(const cv::Mat1b& image, int window_px) {
  cv::Mat1f values, mean, squares;
  image.convertTo(values, CV_32F);
  cv::boxFilter(values, mean, -1, {window_px, window_px});
  cv::boxFilter(values.mul(values), squares, -1, {window_px, window_px});
  cv::Mat1f contrast;
  cv::sqrt(cv::max(squares - mean.mul(mean), 0), contrast);
  return contrast;
}

float median_of(std::vector<float> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// What the camera says of one square of the pattern.
struct Square {
  int seen = 0, poor = 0, saturated = 0;
  double contrast = 0;  // sum, grey levels
};
using Squares = std::vector<Square>;

constexpr int kRows = kPatternHeightPx / kNeedCellPx, kColumns = kPatternWidthPx / kNeedCellPx;

double camera_px_per_projector_px(const SeenPattern& seen) {
  constexpr int kApartPx = 64;
  const cv::Size size = seen.geometry.size_px;
  const double d = seen.geometry.disparity_px(
      0.5 * (seen.surface.nearest_mm + std::min(seen.surface.farthest_mm, 1e5)));
  const auto at = [&](double x) {
    const cv::Point3d p = seen.geometry.point_mm(x, 0.5 * size.height, d);
    return seen.map.project(cv::Vec3d(p.x, p.y, p.z));
  };
  return kApartPx / cv::norm(at(0.5 * size.width + kApartPx) - at(0.5 * size.width));
}

Squares survey(const SeenPattern& seen, const NeedParameters& parameters) {
  const Reconstruction& surface = seen.surface;
  const cv::Mat1f guessed = guessed_depths(surface);
  const int window_px =
      std::max(3, static_cast<int>(std::lround(kWindowPx * camera_px_per_projector_px(seen))));
  const cv::Mat1f contrast = contrast_of(seen.left, window_px);
  const double variance_max = parameters.sigma_max_mm * parameters.sigma_max_mm;
  const cv::Matx34d& P1 = seen.geometry.P1;
  Squares squares(static_cast<std::size_t>(kRows) * static_cast<std::size_t>(kColumns));
  for (int j = 0; j < guessed.rows; ++j)
    for (int i = 0; i < guessed.cols; ++i) {
      const cv::Point at(i * kStepPx, j * kStepPx);
      const auto reason = static_cast<PixelReason>(surface.reasons(at));
      const auto z = static_cast<double>(guessed(j, i));
      if (reason == PixelReason::outside || !(z > 0)) continue;
      const cv::Point in_image = at + surface.region_px.tl();
      const cv::Vec3d p((in_image.x - P1(0, 2)) / P1(0, 0) * z,
                        (in_image.y - P1(1, 2)) / P1(1, 1) * z, z);
      const cv::Point2d lit = seen.map.project(p);
      const auto column = static_cast<int>(std::floor(lit.x / kNeedCellPx));
      const auto row = static_cast<int>(std::floor(lit.y / kNeedCellPx));
      if (column < 0 || row < 0 || column >= kColumns || row >= kRows) continue;
      Square& square =
          squares[static_cast<std::size_t>(row) * kColumns + static_cast<std::size_t>(column)];
      const bool is_good = reason == PixelReason::known &&
                           static_cast<double>(surface.depth_variance_mm2(at)) <= variance_max;
      ++square.seen;
      square.poor += is_good ? 0 : 1;
      square.saturated += seen.left(in_image) >= kSaturated ? 1 : 0;
      square.contrast += static_cast<double>(contrast(in_image));
    }
  return squares;
}

/// Of a cell that has its dot.
double lit_mean_of(const PatternParameters& dots) {
  const double pitch_px = dots.dot_px + dots.distance_px;
  return 255 * 0.25 * CV_PI * dots.dot_px * dots.dot_px / (pitch_px * pitch_px);
}

double mean_around(const cv::Mat1b& image, cv::Point2d centre_px, const PatternParameters& dots) {
  const int side = std::max(2, static_cast<int>(std::lround(dots.dot_px + dots.distance_px)));
  const cv::Rect around(static_cast<int>(std::lround(centre_px.x - 0.5 * side)),
                        static_cast<int>(std::lround(centre_px.y - 0.5 * side)), side, side);
  return cv::mean(image(around & cv::Rect({}, image.size())))[0];
}

}  // namespace

PatternNeeds pattern_needs(const SeenPattern& seen, const NeedParameters& parameters) {
  const Squares squares = survey(seen, parameters);
  cv::Mat1f projected;
  cv::resize(contrast_of(seen.before, kWindowPx), projected, {kColumns, kRows}, 0, 0,
             cv::INTER_AREA);
  std::vector<float> of_pattern, of_image;
  const auto square_at = [&](int row, int column) -> const Square& {
    return squares[static_cast<std::size_t>(row) * kColumns + static_cast<std::size_t>(column)];
  };
  for (int row = 0; row < kRows; ++row)
    for (int column = 0; column < kColumns; ++column) {
      const Square& square = square_at(row, column);
      of_pattern.push_back(projected(row, column));
      if (square.seen > 0 && projected(row, column) > 0)
        of_image.push_back(static_cast<float>(square.contrast / square.seen) /
                           projected(row, column));
    }
  const double usual = static_cast<double>(median_of(of_pattern));
  const double usual_seen = static_cast<double>(median_of(of_image));
  PatternNeeds needs;
  needs.cells = cv::Mat1b(kRows, kColumns, static_cast<uchar>(PatternNeed::none));
  for (int row = 0; row < kRows; ++row)
    for (int column = 0; column < kColumns; ++column) {
      const Square& square = square_at(row, column);
      const auto had = static_cast<double>(projected(row, column));
      const double share = std::max(square.seen, 1);
      PatternNeed need = PatternNeed::other;
      if (square.poor < parameters.poor_share * share || square.poor == 0)
        need = PatternNeed::none;
      else if (square.saturated > parameters.saturated_share * share)
        need = PatternNeed::saturated;
      else if (had < parameters.gap_share * usual)
        need = PatternNeed::gap;
      else if (square.contrast / share < parameters.faint_share * usual_seen * had)
        need = PatternNeed::faint;
      needs.cells(row, column) = static_cast<uchar>(need);
      ++needs.count.at(static_cast<std::size_t>(need));
    }
  return needs;
}

cv::Mat refined_pattern(const PatternParameters& next, const cv::Mat1b& before,
                        const PatternNeeds& needs, const RefinementActions& actions) {
  cv::Mat image = cv::Mat::zeros(before.size(), CV_8UC1);
  for (std::size_t need = 0; need < kNeeds; ++need) {
    PatternParameters dots = next;
    dots.dot_px = std::clamp(actions.scale.at(need) * next.dot_px, kDotMinPx, kDotMaxPx);
    dots.distance_px =
        std::clamp(actions.scale.at(need) * next.distance_px, kDistanceMinPx, kDistanceMaxPx);
    const double lit_mean = lit_mean_of(dots);
    for (const PatternCell& cell : pattern_cells(dots)) {
      const int row = std::clamp(static_cast<int>(cell.centre_px.y / kNeedCellPx), 0, kRows - 1);
      const int column =
          std::clamp(static_cast<int>(cell.centre_px.x / kNeedCellPx), 0, kColumns - 1);
      if (needs.cells(row, column) != need) continue;
      if (mean_around(before, cell.centre_px, dots) < 0.5 * lit_mean)
        draw_dot(image, cell.dot_px, dots.dot_px, actions.grey.at(need));
    }
  }
  return image;
}

cv::Mat complementary_pattern(const PatternParameters& next, const cv::Mat1b& before) {
  PatternNeeds none;
  none.cells = cv::Mat1b(kRows, kColumns, static_cast<uchar>(PatternNeed::none));
  return refined_pattern(next, before, none);
}

}  // namespace holdfast::registration
