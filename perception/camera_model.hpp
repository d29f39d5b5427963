// SPDX-License-Identifier: Apache-2.0
// A pinhole camera with OpenCV's distortion model, and the exact way between its pixels and rays.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

namespace holdfast::perception {

struct CameraModel {
  int width_px = 0, height_px = 0;
  double fx_px = 0, fy_px = 0, cx_px = 0, cy_px = 0;
  cv::Mat distortion;  ///< CV_64F, 0, 4, 5, 8, 12 or 14 coefficients in OpenCV's order

  [[nodiscard]] double f_px() const noexcept { return 0.5 * (fx_px + fy_px); }
  [[nodiscard]] bool is_distorted() const;  ///< some coefficient is not zero
};

/// What is wrong with the camera, in one line with value, limit and unit; empty when it is usable:
/// finite, sensible, and its distortion can be undone all over the image.
[[nodiscard]] std::optional<std::string> invalid_camera(const CameraModel& camera);

/// Pixels of the image to undistorted, normalised coordinates (x/z, y/z). NaN in, NaN out.
[[nodiscard]] std::vector<cv::Point2d> to_normalised(const CameraModel& camera,
                                                     const std::vector<cv::Point2d>& pixels);

/// Normalised coordinates to pixels of the (distorted) image.
[[nodiscard]] std::vector<cv::Point2d> to_pixels(const CameraModel& camera,
                                                 const std::vector<cv::Point2d>& normalised);

}  // namespace holdfast::perception
