// SPDX-License-Identifier: Apache-2.0
#include "rt/pose_filter.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include "safety/numbers.hpp"

namespace holdfast::rt {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using perception::Matrix6d;

Matrix3d skew(const Vector3d& v) noexcept {
  Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

Matrix3d exp_rotation(const Vector3d& r) noexcept {
  const double angle = r.norm();
  if (angle < 1e-12) return Matrix3d::Identity() + skew(r);
  return Eigen::AngleAxisd(angle, r / angle).toRotationMatrix();
}

Vector3d log_rotation(const Matrix3d& R) noexcept {
  const Eigen::AngleAxisd turn{Eigen::Quaterniond(R).normalized()};
  return turn.angle() * turn.axis();
}

bool is_valid(const perception::MotionEstimate& estimate) noexcept {
  return safety::is_rigid(estimate.T_camera_site) && estimate.p_pivot_site_mm.allFinite() &&
         safety::is_covariance(estimate.covariance) &&
         estimate.covariance.llt().info() == Eigen::Success;
}

/// The smallest matrix of its eigenbasis that is nowhere below A nor below B (both positive
/// definite): max(1, eigenvalue) of A measured in units of B, so that mm and rad never mix.
Matrix6d upper_bound(const Matrix6d& A, const Matrix6d& B) noexcept {
  // Nowhere below B already: every eigenvalue is above 1.
  if (Eigen::LLT<Matrix6d>(A - B).info() == Eigen::Success) return 0.5 * (A + A.transpose());
  const Eigen::LLT<Matrix6d> factor(B);
  Matrix6d M = factor.matrixL().solve(A);
  M = factor.matrixL().solve(Matrix6d(M.transpose()));
  const Eigen::SelfAdjointEigenSolver<Matrix6d> solver(0.5 * (M + M.transpose()));
  const Matrix6d basis = factor.matrixL() * solver.eigenvectors();
  const Matrix6d bound =
      basis * solver.eigenvalues().cwiseMax(1.0).asDiagonal() * basis.transpose();
  return 0.5 * (bound + bound.transpose());
}

double seconds(std::chrono::nanoseconds time) noexcept {
  return std::chrono::duration<double>(time).count();
}

}  // namespace

void PoseFilter::reset() noexcept {
  *this = PoseFilter();
}

PoseFilter::Snapshot PoseFilter::snapshot() const noexcept {
  return {has_state_, t_,          T_camera_site_,      p_pivot_site_mm_,
          velocity_,  covariance_, estimate_covariance_};
}

void PoseFilter::restore(const Snapshot& snapshot) noexcept {
  const auto& [has_state, t, T_camera_site, p_pivot, velocity, covariance, estimate_covariance] =
      snapshot;
  has_state_ = has_state;
  t_ = t;
  T_camera_site_ = T_camera_site;
  p_pivot_site_mm_ = p_pivot;
  velocity_ = velocity;
  covariance_ = covariance;
  estimate_covariance_ = estimate_covariance;
}

PoseFilter::Correction PoseFilter::correct(const perception::MotionEstimate& estimate,
                                           const PoseFilterParameters& parameters) noexcept {
  if (!is_valid(estimate)) return Correction::invalid_number;
  if (has_state_ && estimate.t_exposure <= t_) return Correction::not_newer;
  if (!has_state_ || estimate.t_exposure - t_ > parameters.gap_max) {
    start(estimate, parameters);
    return Correction::started;
  }
  PoseFilter next = *this;
  next.move_pivot(estimate.p_pivot_site_mm);
  next.propagate(estimate.t_exposure, parameters);
  if (!next.update(estimate, parameters.innovation_gate_sigma)) return Correction::contradicts;
  *this = next;
  return Correction::corrected;
}

void PoseFilter::start(const perception::MotionEstimate& estimate,
                       const PoseFilterParameters& parameters) noexcept {
  has_state_ = true;
  t_ = estimate.t_exposure;
  T_camera_site_ = estimate.T_camera_site;
  p_pivot_site_mm_ = estimate.p_pivot_site_mm;
  velocity_.setZero();
  const double v = parameters.velocity_sigma_init_mm_per_s;
  const double w = parameters.angular_velocity_sigma_init_rad_per_s;
  covariance_.setZero();
  covariance_.topLeftCorner<6, 6>() = estimate.covariance;
  covariance_.diagonal().segment<3>(6).setConstant(v * v);
  covariance_.diagonal().segment<3>(9).setConstant(w * w);
  estimate_covariance_ = estimate.covariance;
}

/// Errors (dq, dtheta) about one point become errors about another: lever is from the former to the
/// latter, in camera axes; the other point's error is dq + dtheta x lever.
void PoseFilter::move_pivot(const Vector3d& p_pivot_site_mm) noexcept {
  if (p_pivot_site_mm == p_pivot_site_mm_) return;
  const Vector3d lever = T_camera_site_.linear() * (p_pivot_site_mm - p_pivot_site_mm_);
  const Matrix3d L = -skew(lever);
  // F·P·Fᵀ with F = [I L; 0 I] for the pose's error, and again for the velocity's.
  auto& P = covariance_;
  P.topRows<3>() += L * P.middleRows<3>(3);
  P.middleRows<3>(6) += L * P.bottomRows<3>();
  P.leftCols<3>() += P.middleCols<3>(3) * L.transpose();
  P.middleCols<3>(6) += P.rightCols<3>() * L.transpose();
  Matrix6d& E = estimate_covariance_;
  E.topRows<3>() += L * E.bottomRows<3>();
  E.leftCols<3>() += E.rightCols<3>() * L.transpose();
  velocity_.head<3>() += L * velocity_.tail<3>();
  p_pivot_site_mm_ = p_pivot_site_mm;
}

void PoseFilter::propagate(std::chrono::nanoseconds t,
                           const PoseFilterParameters& parameters) noexcept {
  const double dt = seconds(t - t_);
  const Vector3d turn = dt * velocity_.tail<3>();
  const Matrix3d R_turn = exp_rotation(turn);
  const Vector3d q = T_camera_site_ * p_pivot_site_mm_ + dt * velocity_.head<3>();
  const Matrix3d R = R_turn * T_camera_site_.linear();
  T_camera_site_.linear() = Eigen::Quaterniond(R).normalized().toRotationMatrix();
  T_camera_site_.translation() = q - T_camera_site_.linear() * p_pivot_site_mm_;

  // Exp((w+dw)·dt)·Exp(dtheta)·R = Exp(J·dw·dt + R_turn·dtheta)·R_turn·R, with the left Jacobian J
  // of SO(3) to second order: turns between frames are below 0.1 rad.
  const Matrix3d W = skew(turn);
  const Matrix3d J = dt * (Matrix3d::Identity() + W / 2 + W * W / 6);
  // F·P·Fᵀ with F = [I 0 dt·I 0; 0 R_turn 0 J; 0 0 I 0; 0 0 0 I]: rows first, then columns.
  auto& P = covariance_;
  P.topRows<3>() += dt * P.middleRows<3>(6);
  P.middleRows<3>(3) = (R_turn * P.middleRows<3>(3) + J * P.bottomRows<3>()).eval();
  P.leftCols<3>() += dt * P.middleCols<3>(6);
  P.middleCols<3>(3) =
      (P.middleCols<3>(3) * R_turn.transpose() + P.rightCols<3>() * J.transpose()).eval();

  for (int i = 0; i < 6; ++i) {
    const double density = i < 3 ? parameters.acceleration_density_mm2_per_s3
                                 : parameters.angular_acceleration_density_rad2_per_s3;
    covariance_(i, i) += density * dt * dt * dt / 3;
    covariance_(i, i + 6) += density * dt * dt / 2;
    covariance_(i + 6, i) += density * dt * dt / 2;
    covariance_(i + 6, i + 6) += density * dt;
  }
  t_ = t;
}

bool PoseFilter::update(const perception::MotionEstimate& estimate, double gate_sigma) noexcept {
  const Matrix3d R = T_camera_site_.linear();
  const Vector3d q = T_camera_site_ * p_pivot_site_mm_;
  Vector6d innovation;
  innovation << estimate.T_camera_site * p_pivot_site_mm_ - q,
      log_rotation(estimate.T_camera_site.linear() * R.transpose());
  const Matrix6d S = covariance_.topLeftCorner<6, 6>() + estimate.covariance;
  const Eigen::LLT<Matrix6d> S_factor(S);
  const double distance2 = innovation.dot(S_factor.solve(innovation));
  // Negated, so that a NaN contradicts too.
  if (!(distance2 <= gate_sigma * gate_sigma)) return false;

  const Eigen::Matrix<double, 12, 6> K =
      S_factor.solve(covariance_.topRows<6>()).transpose();  // P·Hᵀ·S⁻¹ with H = [I 0]
  const Eigen::Matrix<double, 12, 1> correction = K * innovation;
  velocity_ += correction.tail<6>();
  const Matrix3d R_new = exp_rotation(correction.segment<3>(3)) * R;
  T_camera_site_.linear() = Eigen::Quaterniond(R_new).normalized().toRotationMatrix();
  T_camera_site_.translation() =
      q + correction.head<3>() - T_camera_site_.linear() * p_pivot_site_mm_;

  // Joseph's form: stays positive definite whatever the rounding.
  Matrix12d I_KH = Matrix12d::Identity();
  I_KH.leftCols<6>() -= K;
  const Matrix12d P =
      I_KH * covariance_ * I_KH.transpose() + K * estimate.covariance * K.transpose();
  covariance_ = 0.5 * (P + P.transpose());
  estimate_covariance_ = estimate.covariance;
  return true;
}

std::optional<safety::PredictedPose> PoseFilter::predict(
    std::chrono::nanoseconds now, const PoseFilterParameters& parameters,
    const Vector3d& p_about_site_mm) const noexcept {
  if (!has_state_ || now < t_ || now - t_ > parameters.gap_max) return std::nullopt;
  PoseFilter at_now = *this;
  at_now.propagate(now, parameters);
  at_now.move_pivot(p_about_site_mm);
  safety::PredictedPose pose;
  pose.T_camera_site = at_now.T_camera_site_;
  pose.covariance =
      upper_bound(at_now.covariance_.topLeftCorner<6, 6>(), at_now.estimate_covariance_);
  pose.speed_mm_per_s = at_now.velocity_.head<3>().norm();
  return pose;
}

}  // namespace holdfast::rt
