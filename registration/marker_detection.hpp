// SPDX-License-Identifier: Apache-2.0
// ArUco markers in one raw image, their corners where straight lines fitted to the black square's
// sides meet: an order of magnitude finer than the detector's own corners.
#pragma once

#include <array>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

namespace holdfast::registration {

struct DetectedMarker {
  int id = 0;
  /// Raw pixels, as the detector orders them: clockwise in the image from the marker's own top
  /// left.
  std::array<cv::Point2d, 4> corners;
  Eigen::Matrix<double, 8, 8> covariance_px2;  ///< of x, y of the four corners
};

/// Names of OpenCV's predefined dictionaries without their prefix: 4x4_50 … 7x7_1000,
/// aruco_original. Throws InputError for another name.
[[nodiscard]] int marker_dictionary(const std::string& name);

/// All markers of an 8-bit grey image whose four sides are clear enough to fit, by id (equal ids
/// stay). Lines are straight only without the lens's distortion, hence the camera.
[[nodiscard]] std::vector<DetectedMarker> detect_markers(const cv::Mat& grey, int dictionary,
                                                         const cv::Matx33d& camera_matrix,
                                                         const cv::Mat& distortion);

}  // namespace holdfast::registration
