// SPDX-License-Identifier: Apache-2.0
// The geometry of a rectified stereo pair: OpenCV's stereoRectify with flags 0, so that a toed-in
// microscope keeps its content in view and disparities lie around zero, signed.
#pragma once

#include <opencv2/core.hpp>

#include "registration/stereo_calibration.hpp"

namespace holdfast::registration {

/// p_rectified = R1 · p_camera. Rectified images have the size of the raw ones. Disparity is
/// x_left - x_right on the rectified grids, in pixels, signed.
struct Rectification {
  cv::Size size_px;
  cv::Matx33d R1 = cv::Matx33d::eye(), R2 = cv::Matx33d::eye();
  cv::Matx34d P1 = cv::Matx34d::zeros(), P2 = cv::Matx34d::zeros();  ///< of the rectified cameras

  [[nodiscard]] double focal_px() const { return P1(0, 0); }
  [[nodiscard]] double baseline_mm() const { return -P2(0, 3) / P2(0, 0); }  ///< > 0
  /// Of a point at depth z_mm > 0 of the rectified left camera.
  [[nodiscard]] double disparity_px(double z_mm) const;
  /// The inverse; not positive and finite where the disparity belongs to no point in front.
  [[nodiscard]] double depth_mm(double disparity_px) const;
  /// Of the point seen at (x_px, y_px) with this disparity; rectified left frame, mm.
  [[nodiscard]] cv::Point3d point_mm(double x_px, double y_px, double disparity_px) const;
};

/// Throws InputError when the calibration is not that of a left and a right camera side by side:
/// swapped views or a baseline that is mostly vertical.
[[nodiscard]] Rectification rectification_of(const ZoomCalibration& zoom, cv::Size size_px);

/// The part of the rectified left grid that the raw left rectangle covers, within the image.
[[nodiscard]] cv::Rect rectified_region(const ZoomCalibration& zoom, const Rectification& geometry,
                                        const cv::Rect& raw);

}  // namespace holdfast::registration
