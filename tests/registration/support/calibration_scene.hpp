// SPDX-License-Identifier: Apache-2.0
// A stereo microscope that OpenCV's model does not contain: corners of a slightly bent board as it
// sees them, and the error of a calibration against it.
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Geometry>

#include "registration/calibration_views.hpp"
#include "registration/stereo_calibration.hpp"

namespace holdfast::registration::test {

struct SceneOptions {
  std::uint32_t seed = 1;
  std::vector<double> zooms = {1.1, 1.2, 1.3, 1.4, 1.5};
  int pairs = 19;
  double corner_noise_px = 0.03;
  double tilt_rad = 0.45;               ///< largest; 0: frontal views only
  double foreign_distortion_px = 0.05;  ///< amplitude of what the model does not contain
  double seating_px = 0.25;             ///< principal point, each time a zoom is set
  double bend_mm = 0.03;
};

class CalibrationScene {
 public:
  static constexpr int kWidth = 2456, kHeight = 2054;
  explicit CalibrationScene(const SceneOptions& options);

  [[nodiscard]] const BoardPattern& board() const { return board_; }
  [[nodiscard]] std::vector<ZoomViews> views() const { return views_; }
  /// Pixel of a point of the left camera's frame.
  [[nodiscard]] cv::Point2d pixel(double zoom, bool is_left, const Eigen::Vector3d& p) const;
  /// What a rigid motion leaves of points of the working volume, triangulated by `calibration`, mm.
  [[nodiscard]] double nonrigid_error_mm(const ZoomCalibration& calibration, double zoom) const;

 private:
  struct Side;
  [[nodiscard]] Side side(double zoom, bool is_left) const;
  SceneOptions options_;
  BoardPattern board_;
  std::vector<ZoomViews> views_;
  Eigen::Matrix<double, 2, 24> draws_;
};

}  // namespace holdfast::registration::test
