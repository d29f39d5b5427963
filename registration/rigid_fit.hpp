// SPDX-License-Identifier: Apache-2.0
// The rigid motion between corresponding points of two frames, with the covariance that the points'
// own errors give it, and what it predicts for the error at a target. Start: Horn's closed form
// (J. Opt. Soc. Am. A 4, 1987; paper A, "Rigid body registration"). Then, where the points'
// covariances are known, the maximum-likelihood refinement under them.
#pragma once

#include <string>
#include <vector>

#include <Eigen/Geometry>

namespace holdfast::registration {

using Matrix6d = Eigen::Matrix<double, 6, 6>;
using Vector6d = Eigen::Matrix<double, 6, 1>;

/// One fiducial seen in both frames, mm. Covariances in the axes of their own frame.
struct FiducialPair {
  std::string label;
  Eigen::Vector3d p_ct_mm = Eigen::Vector3d::Zero();
  Eigen::Vector3d p_camera_mm = Eigen::Vector3d::Zero();
  Eigen::Matrix3d covariance_ct_mm2 = Eigen::Matrix3d::Zero();
  Eigen::Matrix3d covariance_camera_mm2 = Eigen::Matrix3d::Zero();
};

struct FiducialSet {
  std::vector<FiducialPair> pairs;
  /// False: the covariances above are not used; the points' error is judged from the residuals.
  bool has_covariances = false;
  /// 3Nx3N covariance of the camera points as they stand in `pairs`, with what they have in common
  /// (the calibration). Empty: independent, covariance_camera_mm2 each.
  Eigen::MatrixXd joint_covariance_camera_mm2;
};

enum class FitStatus {
  fitted,
  too_few,    ///< fewer than three pairs
  collinear,  ///< the rotation about the line through the points is not determined
  invalid     ///< a number is not finite, a covariance not positive definite, or no convergence
};

struct RigidFit {
  FitStatus status = FitStatus::invalid;
  /// Only with FitStatus::fitted.
  Eigen::Isometry3d T_camera_ct = Eigen::Isometry3d::Identity();
  /// tx,ty,tz,rx,ry,rz (mm, rad), fixed camera axes: p_camera = Exp(r)·R·p_ct + t + dt.
  Matrix6d covariance = Matrix6d::Zero();
  /// The part of it that all camera points share, by their joint covariance: the calibration has
  /// moved them together, and whatever else it measures with them.
  Matrix6d common_covariance = Matrix6d::Zero();
  double fre_mm = 0;                 ///< root mean square of the residuals' lengths
  std::vector<double> residuals_mm;  ///< lengths, in the pairs' order
  /// Squared Mahalanobis length of the residuals and the probability of one at least as large if
  /// the stated covariances are true; NaN without covariances.
  double chi_squared = 0, p_value = 0;
  int degrees_of_freedom = 0;  ///< 3N - 6
};

/// The least-squares rotation and translation, unweighted. Needs three or more points that are not
/// in a line; see fit_rigid() for a checked call. 3xN each, same N.
[[nodiscard]] Eigen::Isometry3d horn(const Eigen::Matrix3Xd& p_camera,
                                     const Eigen::Matrix3Xd& p_ct);

/// Pure, re-entrant; allocates. Without covariances the isotropic variance is estimated from the
/// residuals, 3N - 6 degrees of freedom, and the covariance widened from Gauss to Fisher (F 3,
/// 3N-6) so that a target's 95 % region keeps its meaning; three pairs leave no more than 3
/// degrees.
[[nodiscard]] RigidFit fit_rigid(const FiducialSet& fiducials);

/// Covariance (mm^2, camera axes) of where a target of the CT is said to be: the TRE.
[[nodiscard]] Eigen::Matrix3d target_covariance(const Eigen::Isometry3d& T_camera_ct,
                                                const Matrix6d& covariance,
                                                const Eigen::Vector3d& p_target_ct_mm);

/// 3Nx3N covariance (mm^2, camera axes) of p_camera - T·p_ct, all points stacked; the identity for
/// a set without covariances.
[[nodiscard]] Eigen::MatrixXd fiducial_noise(const FiducialSet& fiducials,
                                             const Eigen::Isometry3d& T_camera_ct);

/// The pose after a step (dt, r): Exp(r)·R and t + dt.
[[nodiscard]] Eigen::Isometry3d moved(const Eigen::Isometry3d& T_camera_ct, const Vector6d& step);

/// d(p_camera)/d(dt, r) of a point of the CT (3x6), order as in RigidFit::covariance.
[[nodiscard]] Eigen::Matrix<double, 3, 6> point_jacobian(const Eigen::Isometry3d& T_camera_ct,
                                                         const Eigen::Vector3d& p_ct_mm);

}  // namespace holdfast::registration
