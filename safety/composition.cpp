// SPDX-License-Identifier: Apache-2.0
#include "safety/composition.hpp"

#include <cmath>
#include <limits>

#include <Eigen/Eigenvalues>

namespace holdfast::safety {
namespace {

Eigen::Matrix3d skew(const Eigen::Vector3d& a) noexcept {
  Eigen::Matrix3d matrix;
  matrix << 0, -a.z(), a.y(), a.z(), 0, -a.x(), -a.y(), a.x(), 0;
  return matrix;
}

/// Of errors (position, rotation) about a point, the covariance about another that lies `arm` from
/// it: the position's error there is dp - arm x dtheta.
Matrix6d transported(const Eigen::Vector3d& arm, Matrix6d covariance) noexcept {
  const Eigen::Matrix3d lever = -skew(arm);
  covariance.topRows<3>() += lever * covariance.bottomRows<3>();
  covariance.leftCols<3>() += covariance.rightCols<3>() * lever.transpose();
  return covariance;
}

}  // namespace

Matrix6d rotated(const Eigen::Matrix3d& R_a_b, const Matrix6d& covariance) noexcept {
  Matrix6d result;
  for (int row : {0, 3})
    for (int column : {0, 3}) {
      const Eigen::Matrix3d block = R_a_b * covariance.block<3, 3>(row, column);
      result.block<3, 3>(row, column) = block * R_a_b.transpose();
    }
  return result;
}

Matrix6d covariance_at_target(const PredictedPose& prediction,
                              const RegistrationInput& registration) noexcept {
  const Eigen::Vector3d arm = registration.p_target_site_mm - registration.T_site_ct.translation();
  const Matrix6d site = transported(arm, registration.covariance);
  const Matrix6d sum = prediction.covariance + rotated(prediction.T_camera_site.linear(), site);
  return 0.5 * (sum + sum.transpose());  // exactly symmetric
}

Matrix6d covariance_at_target(const Inputs& inputs) noexcept {
  const PredictedPose& prediction =
      *inputs.prediction;  // NOLINT(bugprone-unchecked-optional-access)
  const Eigen::Vector3d arm = prediction.T_camera_site * inputs.registration.p_target_site_mm;
  const HandEyeSigma& sigma = inputs.hand_eye_sigma;
  Matrix6d hand_eye = rotated(inputs.T_robot_camera.linear().transpose(), sigma.covariance);
  hand_eye.topLeftCorner<3, 3>().diagonal().array() += sigma.t_mm * sigma.t_mm;
  hand_eye.bottomRightCorner<3, 3>().diagonal().array() += sigma.r_rad * sigma.r_rad;
  const Matrix6d sum =
      covariance_at_target(prediction, inputs.registration) + transported(arm, hand_eye);
  return 0.5 * (sum + sum.transpose());
}

double judged_sigma_mm(const Inputs& inputs) noexcept {
  if (!inputs.prediction || !inputs.registration.is_loaded)
    return std::numeric_limits<double>::quiet_NaN();
  return sigma_max_mm(covariance_at_target(inputs));
}

double sigma_max_mm(const Matrix6d& covariance) noexcept {
  const Eigen::Matrix3d position = covariance.topLeftCorner<3, 3>();
  if (!position.allFinite()) return std::numeric_limits<double>::infinity();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(position, Eigen::EigenvaluesOnly);
  return std::sqrt(solver.eigenvalues().z());  // ascending; NaN if negative, which refuses
}

double displacement_mm(const Eigen::Isometry3d& T_camera_site,
                       const Eigen::Vector3d& p_target_site_mm) noexcept {
  const Eigen::Vector3d p_target_camera_mm = T_camera_site * p_target_site_mm;
  return (p_target_camera_mm - p_target_site_mm).norm();
}

double angle_rad(const Eigen::Matrix3d& R) noexcept {
  // sin from the skew part, cos from the trace: exact for small angles, unlike acos alone.
  const Eigen::Vector3d axis(R(2, 1) - R(1, 2), R(0, 2) - R(2, 0), R(1, 0) - R(0, 1));
  return std::atan2(axis.norm(), R.trace() - 1);
}

}  // namespace holdfast::safety
