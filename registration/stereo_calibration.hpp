// SPDX-License-Identifier: Apache-2.0
// The stereo microscope's calibration over zoom (stereo.yaml): one record for each calibrated zoom,
// interpolated in between, refused outside.
#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

namespace holdfast::registration {

/// One zoom. Pixels are those of the raw images; OpenCV's models and conventions throughout.
struct ZoomCalibration {
  double zoom = 0;      ///< magnification as the microscope reports it
  double focus_mm = 0;  ///< working distance
  cv::Matx33d camera_matrix_left = cv::Matx33d::eye();
  cv::Matx33d camera_matrix_right = cv::Matx33d::eye();
  cv::Mat distortion_left,
      distortion_right;                ///< 1xN CV_64F, N = 4, 5, 8, 12 or 14; both the same N
  cv::Matx33d R = cv::Matx33d::eye();  ///< x_right = R·x_left + T
  cv::Vec3d T{0, 0, 0};                ///< mm
  double rms_px = 0;                   ///< reprojection, over all corners of the set
  int pairs_used = 0;
  /// Of the parameters in parameter_vector()'s order. Empty: unknown.
  Eigen::MatrixXd parameter_covariance;
};

struct StereoCalibration {
  int image_width_px = 0, image_height_px = 0;
  std::vector<ZoomCalibration> zooms;  ///< ascending in zoom, none twice
};

/// Reads stereo.yaml. Every value is checked; throws InputError naming file, key, value and limit
/// (not finite, R no rotation, distortion that cannot be undone over the image, covariance of the
/// wrong size or not positive semi-definite, zooms not ascending).
[[nodiscard]] StereoCalibration read_stereo_calibration(const std::string& path);

/// The file's content; the caller writes it.
[[nodiscard]] std::string stereo_calibration_text(const StereoCalibration& calibration);

/// The calibration at `zoom`: the record itself where it was calibrated, interpolated between two.
/// Throws InputError outside the calibrated range unless `may_extrapolate`.
[[nodiscard]] ZoomCalibration calibration_at_zoom(const StereoCalibration& calibration, double zoom,
                                                  bool may_extrapolate = false);

/// fx, fy, cx, cy, distortion (left, then right), R as a rotation vector, T: 2·(4+N)+6 numbers.
[[nodiscard]] Eigen::VectorXd parameter_vector(const ZoomCalibration& zoom);
/// The inverse; `like` gives what the vector does not hold (zoom, focus, N, rms, pairs).
[[nodiscard]] ZoomCalibration with_parameters(const ZoomCalibration& like,
                                              const Eigen::VectorXd& parameters);

}  // namespace holdfast::registration
