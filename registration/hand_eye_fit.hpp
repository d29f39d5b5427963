// SPDX-License-Identifier: Apache-2.0
// Part of hand_eye: the rigid motion that takes spots of the camera onto the robot's points and
// beams, each weighted by what is known of it. A beam is a point on it whose place along the beam
// is as good as unknown; it moves to where the spot is while the fit converges.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <Eigen/Geometry>

#include "registration/rigid_fit.hpp"

namespace holdfast::registration {

/// What the robot knows of one spot, in its own frame.
struct RobotSpot {
  Eigen::Vector3d point_mm = Eigen::Vector3d::Zero();  ///< the spot, or a point of its beam
  std::optional<Eigen::Vector3d> direction;            ///< of the beam; unit length
  double sigma_mm = 0;                                 ///< 1 sigma, each axis, of the point
  double sigma_rad = 0;                                ///< of the beam's direction
};

struct SpotFit {
  RigidFit rigid;  ///< with robot for ct: T_camera_robot; p_value and dof allow for the beams
  FiducialSet fiducials;
  int degrees_of_freedom = 0;  ///< 3 a point, 2 a beam, less 6
  double chi_squared = 0, p_value = 0;
  double rms_mm = 0;                 ///< of the residuals, those of beams across the beam
  std::vector<double> residuals_mm;  ///< likewise
};

/// What all others say about one spot.
struct SpotLeftOut {
  double displacement_mm = 0;  ///< across the beam where it has one
  double squared_sigma = 0;    ///< squared Mahalanobis length
  double p_value = 1;
};

/// `p_camera_mm` with their joint covariance (3Nx3N), and what the robot says. Status as fit_rigid.
[[nodiscard]] SpotFit fit_spots(const std::vector<Eigen::Vector3d>& p_camera_mm,
                                const Eigen::MatrixXd& joint_covariance_mm2,
                                const std::vector<RobotSpot>& robot);

/// Generalised least squares, as leave_one_out().
[[nodiscard]] std::vector<SpotLeftOut> left_out(const SpotFit& fit,
                                                const std::vector<RobotSpot>& robot);

/// By how much the camera's distances exceed the robot's (1: not at all) were that free, and its
/// standard deviation.
struct SpotScale {
  double value = 1, sigma = 0;
};
[[nodiscard]] SpotScale scale_of(const SpotFit& fit);

}  // namespace holdfast::registration
