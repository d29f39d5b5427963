// SPDX-License-Identifier: Apache-2.0
// Part of marker_triangulation: the square in space that fits one marker's corners in both images.
#pragma once

#include <Eigen/Geometry>

#include "registration/marker_detection.hpp"
#include "registration/stereo_calibration.hpp"

namespace holdfast::registration::marker {

using Corners = Eigen::Matrix<double, 16, 1>;  ///< undistorted px: left x, y of four, then right
using Square = Eigen::Matrix<double, 7, 1>;    ///< change of rotation, position mm, side mm
/// What a fit leaves: 16 of the corners, 1 of the side against what is known of it.
using Residual = Eigen::Matrix<double, 17, 1>;

/// Both cameras, ready to project.
struct Camera {
  explicit Camera(const ZoomCalibration& zoom);
  [[nodiscard]] double f(bool is_left) const;

  ZoomCalibration calibration;
  Eigen::Matrix3d R;
  Eigen::Vector3d T;
};

/// The side as it was made; sigma 0: nothing is known.
struct KnownSide {
  double mm = 0, sigma_mm = 0;
};

/// A marker's corners and how well they are known.
struct Sighting {
  const DetectedMarker *left = nullptr, *right = nullptr;
};

/// Weights of Residual: the corners' covariance, on which comes `misfit_px` that the lens model
/// misses, alike for all corners of a marker in one image, x and y each.
[[nodiscard]] Eigen::Matrix<double, 17, 17> information_of(const Sighting& sighting,
                                                           const KnownSide& side, double misfit_px);

struct SquareFit {
  Eigen::Isometry3d T_camera_marker = Eigen::Isometry3d::Identity();
  double side_mm = 0, rms_px = 0;
  Eigen::Matrix<double, 7, 7> covariance = Eigen::Matrix<double, 7, 7>::Zero();  ///< of Square
  Residual residual = Residual::Zero();
};

/// Weighted least squares from `start`, or from the triangulated corners if that is null.
[[nodiscard]] SquareFit fit_square(const Sighting& sighting, const KnownSide& side,
                                   const Eigen::Matrix<double, 17, 17>& information,
                                   const Camera& camera, const SquareFit* start);

[[nodiscard]] Eigen::Isometry3d moved(const Eigen::Isometry3d& T_camera_marker,
                                      const Square& change);

}  // namespace holdfast::registration::marker
