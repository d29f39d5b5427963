// SPDX-License-Identifier: Apache-2.0
// Points in front of the camera to pixels of the raw image, distortion and all, with the
// derivative: what cv::projectPoints computes, for one point, without allocation.
#pragma once

#include <array>

#include <Eigen/Core>

#include "perception/camera_model.hpp"

namespace holdfast::perception {

struct Projection {
  Eigen::Vector2d pixel;
  Eigen::Matrix<double, 2, 3> d_pixel_d_point;  ///< px per mm, at the point
};

class Projector {
 public:
  /// `camera` must have passed invalid_camera().
  explicit Projector(const CameraModel& camera);

  /// Of a point (mm) with z > 0, by OpenCV's model with up to 14 coefficients. Thread-safe.
  [[nodiscard]] Projection project(const Eigen::Vector3d& p_camera) const noexcept;
  /// The pixel alone.
  [[nodiscard]] Eigen::Vector2d pixel(const Eigen::Vector3d& p_camera) const noexcept;

 private:
  struct Distorted {
    Eigen::Vector2d xy;
    Eigen::Matrix2d d_xy;
  };
  [[nodiscard]] Distorted distort(const Eigen::Vector2d& xy) const noexcept;

  double fx_px_, fy_px_, cx_px_, cy_px_;
  bool is_distorted_, is_tilted_ = false;
  std::array<double, 12> k_{};  ///< k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4
  Eigen::Matrix3d tilt_ = Eigen::Matrix3d::Identity();
};

}  // namespace holdfast::perception
