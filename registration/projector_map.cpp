// SPDX-License-Identifier: Apache-2.0
#include "registration/projector_map.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <vector>

#include <fmt/format.h>
#include <opencv2/core.hpp>

#include "registration/pattern.hpp"

namespace holdfast::registration {
namespace {

/// Projective least squares of (x/z, y/z, 1, z0/z - 1) to projector pixels. On a plane the last
/// coordinate says nothing new: a little weight keeps its coefficients at zero there.
cv::Matx34d fitted(const std::vector<PatternAnchor>& anchors) {
  constexpr double kSpread = 5;  // brings rays and relief to the order of 1
  constexpr double kDamping = 1e-4, kHalfWidthPx = 0.5 * kPatternWidthPx,
                   kHalfHeightPx = 0.5 * kPatternHeightPx;
  double z0 = 0;
  for (const PatternAnchor& a : anchors) z0 += static_cast<double>(a.p_mm[2]);
  z0 /= static_cast<double>(anchors.size());
  cv::Matx<double, 12, 12> normal = cv::Matx<double, 12, 12>::zeros();
  for (const PatternAnchor& a : anchors) {
    const cv::Vec3d p = a.p_mm;
    const double m[4] = {kSpread * p[0] / p[2], kSpread * p[1] / p[2], 1,
                         kSpread * (z0 / p[2] - 1)};
    const double at[2] = {a.projector_px.x / kHalfWidthPx - 1,
                          a.projector_px.y / kHalfHeightPx - 1};
    for (int k = 0; k < 2; ++k) {
      cv::Vec<double, 12> row = cv::Vec<double, 12>::all(0);
      for (int i = 0; i < 4; ++i) {
        row[4 * k + i] = m[i];
        row[8 + i] = -at[k] * m[i];
      }
      normal += row * row.t();
    }
  }
  for (const int i : {3, 7, 11}) normal(i, i) += kDamping * static_cast<double>(anchors.size());
  cv::Matx<double, 12, 1> values;
  cv::Matx<double, 12, 12> vectors;
  cv::eigen(normal, values, vectors);
  cv::Matx34d P;
  for (int r = 0; r < 3; ++r) {
    const double h[4] = {kSpread * vectors(11, 4 * r), kSpread * vectors(11, 4 * r + 1),
                         vectors(11, 4 * r + 2), kSpread * vectors(11, 4 * r + 3)};
    P(r, 0) = h[0];
    P(r, 1) = h[1];
    P(r, 2) = h[2] - h[3];
    P(r, 3) = h[3] * z0;
  }
  const cv::Matx33d to_pixels(kHalfWidthPx, 0, kHalfWidthPx, 0, kHalfHeightPx, kHalfHeightPx, 0, 0,
                              1);
  return to_pixels * P;
}

double distance_px(const ProjectorMap& map, const PatternAnchor& anchor) {
  return cv::norm(map.project(anchor.p_mm) - anchor.projector_px);
}

}  // namespace

cv::Point2d ProjectorMap::project(const cv::Vec3f& p) const {
  const cv::Vec3d q = projection * cv::Vec4d(static_cast<double>(p[0]), static_cast<double>(p[1]),
                                             static_cast<double>(p[2]), 1);
  return {q[0] / q[2], q[1] / q[2]};
}

ProjectorMap find_projector(const cv::Mat1b& pattern, const cv::Mat1b& left,
                            const Reconstruction& surface, const ProjectorLimits& limits) {
  constexpr int kRounds = 6;
  constexpr double kOutlierPx = 1, kOutlierMedians = 3;
  ProjectorMap map;
  std::vector<PatternAnchor> anchors = find_anchors(pattern, left, surface, limits.search);
  const auto too_few = [&] {
    map.anchors = static_cast<int>(anchors.size());
    map.evidence = fmt::format("{} parts of the image were found in the pattern, must be {}",
                               map.anchors, limits.anchors_min);
    return map.anchors < limits.anchors_min;
  };
  if (too_few()) return map;
  std::vector<PatternAnchor> used = anchors;
  for (int round = 0; round < kRounds; ++round) {
    map.projection = fitted(used);
    std::vector<double> distances;
    for (const PatternAnchor& a : anchors) distances.push_back(distance_px(map, a));
    const auto middle = distances.begin() + static_cast<std::ptrdiff_t>(distances.size() / 2);
    std::nth_element(distances.begin(), middle, distances.end());
    const double limit = std::max(kOutlierPx, kOutlierMedians * *middle);
    used.clear();
    std::copy_if(anchors.begin(), anchors.end(), std::back_inserter(used),
                 [&](const PatternAnchor& a) { return distance_px(map, a) < limit; });
  }
  anchors = used;
  if (too_few()) return map;
  double squares = 0;
  for (const PatternAnchor& a : anchors) squares += std::pow(distance_px(map, a), 2);
  map.residual_px = std::sqrt(squares / map.anchors);
  map.is_found = map.residual_px <= limits.residual_max_px;
  map.evidence = map.is_found ? std::string()
                              : fmt::format(
                                    "parts of the pattern lie {:.2f} projector pixels from "
                                    "where one projector would have them, limit {:.2f}",
                                    map.residual_px, limits.residual_max_px);
  return map;
}

}  // namespace holdfast::registration
