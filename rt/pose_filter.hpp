// SPDX-License-Identifier: Apache-2.0
// Constant-velocity filter of T_camera_site: corrects with stamped estimates, predicts to now, and
// grows its covariance with time. Pure, noexcept, allocation-free.
//
// State: the pivot's position q in the camera, the site's rotation R, the pivot's velocity v and
// the angular velocity w, all in camera axes. Error state: dq, dtheta, dv, dw, with p_camera =
// Exp(dtheta)·R·(p_site - p_pivot_site) + q + dq, as MotionEstimate::covariance has it.
//
// Motion model: continuous white noise acceleration of the given density per axis: over a time dt,
// Q = density * [dt^3/3, dt^2/2; dt^2/2, dt] for each pair (position, velocity) (Bar-Shalom,
// Estimation with Applications to Tracking and Navigation, section 6.2.2). Not the discrete model
// of an acceleration that is constant between estimates: with estimates as exact as ours its gain
// turns a wrong velocity into its negative at every frame, for ever; here it shrinks by 3.7.
#pragma once

#include <chrono>
#include <optional>

#include <Eigen/Geometry>

#include "perception/motion_estimate.hpp"
#include "safety/gate.hpp"

namespace holdfast::rt {

struct PoseFilterParameters {
  /// Per axis, mm^2/s^3. 150 covers a reversal at paper B's 2 mm/s within 2 sigma of the velocity
  /// at 30 frames/s, and lets the position's sigma grow to 0.17 mm in 83 ms.
  double acceleration_density_mm2_per_s3 = 150.0;
  double angular_acceleration_density_rad2_per_s3 = 0.06;  ///< per axis, likewise
  double velocity_sigma_init_mm_per_s = 10.0;              ///< at the first estimate
  double angular_velocity_sigma_init_rad_per_s = 0.05;
  double innovation_gate_sigma =
      6.0;  ///< Mahalanobis distance beyond which an estimate contradicts
  /// Longest time without an accepted estimate: beyond it nothing is predicted, and the next
  /// estimate starts the filter anew.
  std::chrono::nanoseconds gap_max = std::chrono::milliseconds(300);
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
  /// Takes in one estimate (status other than lost). On contradicts, not_newer and invalid_number
  /// the state is left unchanged; after gap_max of contradictions the next estimate starts it anew.
  /// invalid_number: not finite, not a rotation, or a covariance that is not positive definite.
  Correction correct(const perception::MotionEstimate& estimate,
                     const PoseFilterParameters& parameters) noexcept;

  /// Pose at `now`, with covariance and speed about the site's point `p_about_site_mm` (site
  /// frame). Nothing before the first estimate, for a `now` before the newest one, or more than
  /// gap_max after it. The covariance is nowhere smaller than the newest estimate's own: errors
  /// against one keyframe are common to all its estimates, so that averaging does not remove them.
  [[nodiscard]] std::optional<safety::PredictedPose> predict(
      std::chrono::nanoseconds now, const PoseFilterParameters& parameters,
      const Eigen::Vector3d& p_about_site_mm) const noexcept;
  /// The same about the pivot.
  [[nodiscard]] std::optional<safety::PredictedPose> predict(
      std::chrono::nanoseconds now, const PoseFilterParameters& parameters) const noexcept {
    return predict(now, parameters, p_pivot_site_mm_);
  }
  [[nodiscard]] bool has_state() const noexcept { return has_state_; }
  /// Exposure of the newest estimate taken in.
  [[nodiscard]] std::chrono::nanoseconds t_newest() const noexcept { return t_; }

  using Vector6d = Eigen::Matrix<double, 6, 1>;
  using Matrix6d = perception::Matrix6d;
  using Matrix12d = Eigen::Matrix<double, 12, 12>;
  /// All that it remembers, for recordings: a filter restored from it goes on bit for bit alike.
  struct Snapshot {
    bool has_state = false;
    std::chrono::nanoseconds t{};
    Eigen::Isometry3d T_camera_site = Eigen::Isometry3d::Identity();
    Eigen::Vector3d p_pivot_site_mm = Eigen::Vector3d::Zero();
    Vector6d velocity = Vector6d::Zero();
    Matrix12d covariance = Matrix12d::Identity();
    Matrix6d estimate_covariance = Matrix6d::Identity();
  };
  [[nodiscard]] Snapshot snapshot() const noexcept;
  void restore(const Snapshot& snapshot) noexcept;

 private:
  void start(const perception::MotionEstimate& estimate,
             const PoseFilterParameters& parameters) noexcept;
  void move_pivot(const Eigen::Vector3d& p_pivot_site_mm) noexcept;
  void propagate(std::chrono::nanoseconds t, const PoseFilterParameters& parameters) noexcept;
  [[nodiscard]] bool update(const perception::MotionEstimate& estimate, double gate_sigma) noexcept;

  bool has_state_ = false;
  std::chrono::nanoseconds t_{};
  Eigen::Isometry3d T_camera_site_ = Eigen::Isometry3d::Identity();
  Eigen::Vector3d p_pivot_site_mm_ = Eigen::Vector3d::Zero();
  Vector6d velocity_ = Vector6d::Zero();  ///< of the pivot (mm/s) and angular (rad/s), camera axes
  Matrix12d covariance_ = Matrix12d::Identity();
  Matrix6d estimate_covariance_ = Matrix6d::Identity();  ///< of the newest estimate
};

}  // namespace holdfast::rt
