// SPDX-License-Identifier: Apache-2.0
// A pinhole camera with OpenCV's distortion model.
#pragma once

#include <opencv2/core.hpp>

namespace holdfast::perception {

struct CameraModel {
  int width_px = 0, height_px = 0;
  double fx_px = 0, fy_px = 0, cx_px = 0, cy_px = 0;
  cv::Mat distortion;  ///< CV_64F, 0, 4, 5, 8, 12 or 14 coefficients in OpenCV's order
};

}  // namespace holdfast::perception
