// SPDX-License-Identifier: Apache-2.0
// From the predicted motion and the registration to the pose in robot axes, with its covariance
// carried to the target. Pure, noexcept, allocation-free.
//
// With p_t the target in the site, R_cs and R_rc the rotations of T_camera_site(now) and
// T_robot_camera, and t_sc the translation of T_site_ct:
//
//   T_robot_ct = T_robot_camera · T_camera_site(now) · T_site_ct
//
//   Registration error: p_site = Exp(r)·R·p_ct + t + dt turns about t_sc; at the target it moves by
//   dt + r x a, a = p_t - t_sc:         C_site   = J·C_reg·J^T,  J = [I, -[a]x; 0, I]
//   Prediction error is already about the target; both are independent, to first order
//                                       C_camera = C_pred + B(R_cs)·C_site·B(R_cs)^T
//   Hand-eye error turns about the camera; at the target, b = T_camera_site(now)·p_t, it adds
//   C_hand_eye = K·(diag(s_t^2 I, s_r^2 I) + C_measured)·K^T, K = [I, -[b]x; 0, I]
//   with the measured part's axes, the robot's, turned to the camera's: B(R_rc)^T·C·B(R_rc)
//   Robot axes, still about the target: C_robot  = B(R_rc)·(C_camera + C_hand_eye)·B(R_rc)^T
//
// with B(R) = diag(R, R).
#pragma once

#include <Eigen/Geometry>

#include "safety/gate.hpp"

namespace holdfast::safety {

/// tx,ty,tz,rx,ry,rz (mm, rad; camera axes, about the target) of prediction and registration.
[[nodiscard]] Matrix6d covariance_at_target(const PredictedPose& prediction,
                                            const RegistrationInput& registration) noexcept;

/// That of prediction, registration and hand-eye calibration: what the gate judges and publishes.
/// `inputs` must have a prediction.
[[nodiscard]] Matrix6d covariance_at_target(const Inputs& inputs) noexcept;

/// sigma_max_mm() of it; NaN, which every limit refuses, without a prediction or a registration.
[[nodiscard]] double judged_sigma_mm(const Inputs& inputs) noexcept;

/// The same covariance in the axes of frame a, given the rotation from b's axes to a's.
[[nodiscard]] Matrix6d rotated(const Eigen::Matrix3d& R_a_b, const Matrix6d& covariance) noexcept;

/// 1-sigma along the largest axis of the position block; infinity when it is not finite.
[[nodiscard]] double sigma_max_mm(const Matrix6d& covariance) noexcept;

/// Displacement of the target since the keyframe, in mm.
[[nodiscard]] double displacement_mm(const Eigen::Isometry3d& T_camera_site,
                                     const Eigen::Vector3d& p_target_site_mm) noexcept;

/// Angle of a rotation, 0..pi.
[[nodiscard]] double angle_rad(const Eigen::Matrix3d& R) noexcept;

}  // namespace holdfast::safety
