// SPDX-License-Identifier: Apache-2.0
#include "registration/rectification.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include <fmt/format.h>
#include <opencv2/calib3d.hpp>

#include "rt/core/error.hpp"

namespace holdfast::registration {

double Rectification::disparity_px(double z_mm) const {
  return focal_px() * baseline_mm() / z_mm + P1(0, 2) - P2(0, 2);
}

double Rectification::depth_mm(double disparity_px) const {
  return focal_px() * baseline_mm() / (disparity_px - P1(0, 2) + P2(0, 2));
}

cv::Point3d Rectification::point_mm(double x_px, double y_px, double disparity_px) const {
  const double z = depth_mm(disparity_px);
  return {(x_px - P1(0, 2)) / P1(0, 0) * z, (y_px - P1(1, 2)) / P1(1, 1) * z, z};
}

Rectification rectification_of(const ZoomCalibration& zoom, cv::Size size_px) {
  if (!(zoom.T[0] < 0) || std::abs(zoom.T[1]) > 0.5 * std::abs(zoom.T[0]))
    throw InputError(
        fmt::format("stereo calibration at zoom {}: T = ({:.3f}, {:.3f}, {:.3f}) mm is not that of "
                    "a right camera beside the left one (T_x must be negative and the largest)",
                    zoom.zoom, zoom.T[0], zoom.T[1], zoom.T[2]));
  Rectification geometry;
  geometry.size_px = size_px;
  cv::Matx44d Q;
  cv::stereoRectify(zoom.camera_matrix_left, zoom.distortion_left, zoom.camera_matrix_right,
                    zoom.distortion_right, size_px, zoom.R, zoom.T, geometry.R1, geometry.R2,
                    geometry.P1, geometry.P2, Q, 0);
  return geometry;
}

cv::Rect rectified_region(const ZoomCalibration& zoom, const Rectification& geometry,
                          const cv::Rect& raw) {
  constexpr int kSteps = 16;  // an edge's image is curved by the lens only
  std::vector<cv::Point2d> outline;
  const cv::Point2d first = raw.tl(), last(raw.br().x - 1.0, raw.br().y - 1.0);
  for (int i = 0; i <= kSteps; ++i) {
    const double x = first.x + (last.x - first.x) * i / kSteps;
    const double y = first.y + (last.y - first.y) * i / kSteps;
    outline.insert(outline.end(), {{x, first.y}, {x, last.y}, {first.x, y}, {last.x, y}});
  }
  std::vector<cv::Point2d> seen;
  cv::undistortPoints(outline, seen, zoom.camera_matrix_left, zoom.distortion_left, geometry.R1,
                      geometry.P1);
  double x0 = 1e9, y0 = 1e9, x1 = -1e9, y1 = -1e9;
  for (const cv::Point2d& p : seen) {
    x0 = std::min(x0, p.x), x1 = std::max(x1, p.x);
    y0 = std::min(y0, p.y), y1 = std::max(y1, p.y);
  }
  const cv::Point from(static_cast<int>(std::floor(x0)), static_cast<int>(std::floor(y0)));
  const cv::Point to(static_cast<int>(std::ceil(x1)) + 1, static_cast<int>(std::ceil(y1)) + 1);
  return cv::Rect(from, to) & cv::Rect({}, geometry.size_px);
}

}  // namespace holdfast::registration
