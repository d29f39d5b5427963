// SPDX-License-Identifier: Apache-2.0
#include "registration/marker_square.hpp"

#include <cmath>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <opencv2/core/eigen.hpp>

#include "registration/triangulation.hpp"

namespace holdfast::registration::marker {

Camera::Camera(const ZoomCalibration& zoom) : calibration(zoom) {
  cv::cv2eigen(zoom.R, R);
  T = {zoom.T[0], zoom.T[1], zoom.T[2]};
}

double Camera::f(bool is_left) const {
  const cv::Matx33d& K = is_left ? calibration.camera_matrix_left : calibration.camera_matrix_right;
  return 0.5 * (K(0, 0) + K(1, 1));
}

namespace {

Corners undistorted(const Sighting& sighting, const Camera& camera) {
  Corners corners;
  Eigen::Index at = 0;
  for (const bool is_left : {true, false}) {
    const auto& pixels = is_left ? sighting.left->corners : sighting.right->corners;
    const ZoomCalibration& zoom = camera.calibration;
    for (const Eigen::Vector2d& ray :
         rays({pixels.begin(), pixels.end()},
              is_left ? zoom.camera_matrix_left : zoom.camera_matrix_right,
              is_left ? zoom.distortion_left : zoom.distortion_right)) {
      corners.segment<2>(at) = camera.f(is_left) * ray;
      at += 2;
    }
  }
  return corners;
}

/// In the detector's order: clockwise from the marker's own top left; y up, z towards the viewer.
Corners projected(const Eigen::Isometry3d& T_camera_marker, double side_mm, const Camera& camera) {
  Corners corners;
  const double h = side_mm / 2;
  const Eigen::Vector3d square[4] = {{-h, h, 0}, {h, h, 0}, {h, -h, 0}, {-h, -h, 0}};
  for (Eigen::Index i = 0; i < 4; ++i) {
    const Eigen::Vector3d p = T_camera_marker * square[i];
    const Eigen::Vector3d q = camera.R * p + camera.T;
    corners.segment<2>(2 * i) = camera.f(true) * p.head<2>() / p.z();
    corners.segment<2>(8 + 2 * i) = camera.f(false) * q.head<2>() / q.z();
  }
  return corners;
}

/// From the four triangulated corners.
SquareFit first_square(const Sighting& sighting, const Camera& camera) {
  const auto &left = *sighting.left, &right = *sighting.right;
  const auto points = triangulate({left.corners.begin(), left.corners.end()},
                                  {right.corners.begin(), right.corners.end()}, camera.calibration);
  Eigen::Vector3d p[4];
  for (std::size_t i = 0; i < 4; ++i) p[i] = points[i].p_camera_mm;
  SquareFit fit;
  const Eigen::Vector3d x = (p[1] - p[0] + p[2] - p[3]).normalized();
  const Eigen::Vector3d z = x.cross(p[0] - p[3] + p[1] - p[2]).normalized();
  fit.T_camera_marker.linear() << x, z.cross(x), z;
  fit.T_camera_marker.translation() = (p[0] + p[1] + p[2] + p[3]) / 4;
  for (int i = 0; i < 4; ++i) fit.side_mm += (p[(i + 1) % 4] - p[i]).norm() / 4;
  return fit;
}

/// Weighted least squares from `fit`; the weights are those of the corners' covariance.
Residual residual_of(const SquareFit& fit, const Corners& seen, const KnownSide& side,
                     const Camera& camera) {
  Residual residual;
  residual << seen - projected(fit.T_camera_marker, fit.side_mm, camera), side.mm - fit.side_mm;
  return residual;
}

}  // namespace

Eigen::Isometry3d moved(const Eigen::Isometry3d& T_camera_marker, const Square& change) {
  Eigen::Isometry3d result = T_camera_marker;
  const Eigen::Vector3d r = change.head<3>();
  if (r.norm() > 0)
    result.linear() =
        Eigen::AngleAxisd(r.norm(), r.normalized()).toRotationMatrix() * result.linear();
  result.translation() += change.segment<3>(3);
  return result;
}

Eigen::Matrix<double, 17, 17> information_of(const Sighting& sighting, const KnownSide& side,
                                             double misfit_px) {
  Eigen::Matrix<double, 16, 16> covariance = Eigen::Matrix<double, 16, 16>::Zero();
  covariance.topLeftCorner<8, 8>() = sighting.left->covariance_px2;
  covariance.bottomRightCorner<8, 8>() = sighting.right->covariance_px2;
  covariance.diagonal().array() += 1e-6;
  for (Eigen::Index r = 0; r < 16; ++r)
    for (Eigen::Index c = r % 2; c < 16; c += 2)
      if ((r < 8) == (c < 8)) covariance(r, c) += misfit_px * misfit_px;
  Eigen::Matrix<double, 17, 17> information = Eigen::Matrix<double, 17, 17>::Zero();
  information.topLeftCorner<16, 16>() = covariance.inverse();
  information(16, 16) = side.sigma_mm > 0 ? 1 / (side.sigma_mm * side.sigma_mm) : 0;
  return information;
}

SquareFit fit_square(const Sighting& sighting, const KnownSide& side,
                     const Eigen::Matrix<double, 17, 17>& information, const Camera& camera,
                     const SquareFit* start) {
  SquareFit fit = start != nullptr ? *start : first_square(sighting, camera);
  const Corners seen = undistorted(sighting, camera);
  for (int iteration = 0; iteration < 8; ++iteration) {
    constexpr double kStep = 1e-5;
    const Residual here = residual_of(fit, seen, side, camera);
    Eigen::Matrix<double, 17, 7> jacobian;
    for (Eigen::Index k = 0; k < 7; ++k) {
      Square step = Square::Zero();
      step[k] = kStep;
      SquareFit there = fit;
      there.T_camera_marker = moved(fit.T_camera_marker, step);
      there.side_mm += step[6];
      jacobian.col(k) = (here - residual_of(there, seen, side, camera)) / kStep;
    }
    const Eigen::Matrix<double, 7, 7> normal = jacobian.transpose() * information * jacobian;
    const Eigen::LDLT<Eigen::Matrix<double, 7, 7>> solver(normal);
    const Square change = solver.solve(jacobian.transpose() * information * here);
    fit.T_camera_marker = moved(fit.T_camera_marker, change);
    fit.side_mm += change[6];
    fit.covariance = solver.solve(Eigen::Matrix<double, 7, 7>::Identity());
  }
  fit.residual = residual_of(fit, seen, side, camera);
  fit.rms_px = std::sqrt(fit.residual.head<16>().squaredNorm() / 8);
  return fit;
}

}  // namespace holdfast::registration::marker
