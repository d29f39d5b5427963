// SPDX-License-Identifier: Apache-2.0
// Constant-velocity filter of T_camera_site: corrects with stamped estimates, predicts to now, and
// grows its covariance with time. Pure, noexcept, allocation-free.
#pragma once

#include <chrono>
#include <optional>

#include <Eigen/Geometry>

#include "perception/motion_estimate.hpp"
#include "safety/gate.hpp"

namespace holdfast::rt {

struct PoseFilterParameters {
  double acceleration_sigma_mm_per_s2 = 200.0;  ///< white acceleration, per axis
  double angular_acceleration_sigma_rad_per_s2 = 1.0;
  double velocity_sigma_init_mm_per_s = 10.0;  ///< at the first estimate
  double angular_velocity_sigma_init_rad_per_s = 0.05;
  double innovation_gate_sigma =
      6.0;  ///< Mahalanobis distance beyond which an estimate contradicts
  std::chrono::nanoseconds gap_max =
      std::chrono::milliseconds(300);  ///< longer gap between estimates: start anew
};

class PoseFilter {
 public:
  /// Forgets everything.
  void reset() noexcept;
  enum class Correction : std::uint8_t {
    started,
    corrected,
    contradicts,
    not_newer,
    invalid_number
  };
  /// Takes in one estimate (status other than lost). On contradicts the state is left unchanged.
  Correction correct(const perception::MotionEstimate& estimate,
                     const PoseFilterParameters& parameters) noexcept;
  /// Pose, covariance and speed at `now` (not before the newest estimate); nothing before the
  /// first.
  [[nodiscard]] std::optional<safety::PredictedPose> predict(
      std::chrono::nanoseconds now, const PoseFilterParameters& parameters) const noexcept;
  [[nodiscard]] bool has_state() const noexcept { return has_state_; }

 private:
  using Vector6d = Eigen::Matrix<double, 6, 1>;
  using Matrix12d = Eigen::Matrix<double, 12, 12>;
  bool has_state_ = false;
  std::chrono::nanoseconds t_{};
  Eigen::Isometry3d T_camera_site_ = Eigen::Isometry3d::Identity();
  Eigen::Vector3d p_pivot_site_mm_ = Eigen::Vector3d::Zero();
  Vector6d velocity_ = Vector6d::Zero();  ///< of the pivot (mm/s) and angular (rad/s), camera axes
  Matrix12d covariance_ = Matrix12d::Identity();
};

}  // namespace holdfast::rt
