// SPDX-License-Identifier: Apache-2.0
#include "perception/projection.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/Geometry>

namespace holdfast::perception {
namespace {

/// The homography of a sensor tilted by (tau_x, tau_y), as OpenCV's computeTiltProjectionMatrix.
Eigen::Matrix3d tilt_homography(double tau_x, double tau_y) {
  Eigen::Matrix3d about_x = Eigen::Matrix3d::Identity(), about_y = about_x, to_plane = about_x;
  about_x.bottomRightCorner<2, 2>() << std::cos(tau_x), std::sin(tau_x), -std::sin(tau_x),
      std::cos(tau_x);
  about_y << std::cos(tau_y), 0, -std::sin(tau_y), 0, 1, 0, std::sin(tau_y), 0, std::cos(tau_y);
  const Eigen::Matrix3d R = about_y * about_x;
  to_plane << R(2, 2), 0, -R(0, 2), 0, R(2, 2), -R(1, 2), 0, 0, 1;
  return to_plane * R;
}

}  // namespace

Projector::Projector(const CameraModel& camera)
    : fx_px_(camera.fx_px),
      fy_px_(camera.fy_px),
      cx_px_(camera.cx_px),
      cy_px_(camera.cy_px),
      is_distorted_(camera.is_distorted()) {
  const std::size_t n = camera.distortion.total();
  for (std::size_t i = 0; i < std::min(n, k_.size()); ++i)
    k_[i] = camera.distortion.at<double>(static_cast<int>(i));
  if (n == 14) {
    tilt_ = tilt_homography(camera.distortion.at<double>(12), camera.distortion.at<double>(13));
    is_tilted_ = !tilt_.isIdentity(0);
  }
}

Projector::Distorted Projector::distort(const Eigen::Vector2d& xy) const noexcept {
  const auto& [k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4] = k_;
  const double x = xy.x(), y = xy.y(), r2 = x * x + y * y;
  const double over = 1 + r2 * (k1 + r2 * (k2 + r2 * k3));
  const double under = 1 / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)));
  const double radial = over * under;
  const double d_over = k1 + r2 * (2 * k2 + r2 * 3 * k3);
  const double d_under = k4 + r2 * (2 * k5 + r2 * 3 * k6);
  const double d_radial = (d_over - radial * d_under) * under;  // by r2
  const Eigen::Vector2d prism(s1 + 2 * s2 * r2, s3 + 2 * s4 * r2);
  Distorted out;
  out.xy << x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + r2 * (s1 + s2 * r2),
      y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + r2 * (s3 + s4 * r2);
  const double cross = 2 * x * y * d_radial;
  out.d_xy << radial + 2 * x * x * d_radial + 2 * p1 * y + 6 * p2 * x + 2 * x * prism.x(),
      cross + 2 * p1 * x + 2 * p2 * y + 2 * y * prism.x(),
      cross + 2 * p1 * x + 2 * p2 * y + 2 * x * prism.y(),
      radial + 2 * y * y * d_radial + 6 * p1 * y + 2 * p2 * x + 2 * y * prism.y();
  if (!is_tilted_) return out;
  const Eigen::Vector3d h = tilt_ * out.xy.homogeneous();
  const Eigen::Vector2d q = h.head<2>() / h.z();
  const Eigen::Matrix2d d =
      (tilt_.topLeftCorner<2, 2>() - q * tilt_.bottomLeftCorner<1, 2>()) / h.z();
  out.d_xy = (d * out.d_xy).eval();
  out.xy = q;
  return out;
}

Projection Projector::project(const Eigen::Vector3d& p_camera) const noexcept {
  const double iz = 1 / p_camera.z();
  const Eigen::Vector2d xy = iz * p_camera.head<2>();
  Eigen::Matrix<double, 2, 3> d_xy;
  d_xy << iz, 0, -iz * xy.x(), 0, iz, -iz * xy.y();
  Projection out;
  if (is_distorted_) {
    const Distorted distorted = distort(xy);
    out.pixel = distorted.xy;
    out.d_pixel_d_point.noalias() = distorted.d_xy * d_xy;
  } else {
    out.pixel = xy;
    out.d_pixel_d_point = d_xy;
  }
  out.pixel.x() = fx_px_ * out.pixel.x() + cx_px_;
  out.pixel.y() = fy_px_ * out.pixel.y() + cy_px_;
  out.d_pixel_d_point.row(0) *= fx_px_;
  out.d_pixel_d_point.row(1) *= fy_px_;
  return out;
}

Eigen::Vector2d Projector::pixel(const Eigen::Vector3d& p_camera) const noexcept {
  Eigen::Vector2d xy = p_camera.head<2>() / p_camera.z();
  if (is_distorted_) xy = distort(xy).xy;
  return {fx_px_ * xy.x() + cx_px_, fy_px_ * xy.y() + cy_px_};
}

}  // namespace holdfast::perception
