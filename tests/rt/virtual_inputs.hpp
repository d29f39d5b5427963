// SPDX-License-Identifier: Apache-2.0
// What a healthy camera, tracker, robot and operator hand to the control step, in virtual time and
// without chance: the same instants give the same readings. Tests spoil what they need spoiled.
#pragma once

#include <cmath>
#include <cstdint>

#include "rt/control_step.hpp"

namespace holdfast::rt::testing {

using std::chrono::microseconds;
using std::chrono::milliseconds;

inline constexpr safety::Timestamp kStart = std::chrono::seconds(1000);
inline constexpr safety::Duration kFramePeriod = microseconds(33'333);
inline constexpr safety::Duration kReceivedAfter = milliseconds(6);    // exposure to arrival
inline constexpr safety::Duration kPublishedAfter = milliseconds(16);  // exposure to estimate

/// 2 mm/s to and fro along x, as fast as paper B's robot, with a small turn about z.
inline Eigen::Isometry3d site_at(safety::Timestamp t) {
  const double s = std::chrono::duration<double>(t - kStart).count();
  Eigen::Isometry3d T_camera_site = Eigen::Isometry3d::Identity();
  T_camera_site.translation().x() = 2.0 * std::sin(s);
  T_camera_site.linear() =
      Eigen::AngleAxisd(0.01 * std::sin(0.7 * s), Eigen::Vector3d::UnitZ()).toRotationMatrix();
  return T_camera_site;
}

inline perception::Matrix6d diagonal_covariance(double sigma_mm, double sigma_rad) {
  perception::Matrix6d covariance = perception::Matrix6d::Zero();
  covariance.diagonal().head<3>().setConstant(sigma_mm * sigma_mm);
  covariance.diagonal().tail<3>().setConstant(sigma_rad * sigma_rad);
  return covariance;
}

inline perception::MotionEstimate healthy_estimate(safety::Timestamp t_exposure) {
  perception::MotionEstimate motion;
  motion.status = perception::TrackingStatus::tracking;
  motion.reason = perception::TrackingReason::none;
  motion.t_exposure = t_exposure;
  motion.T_camera_site = site_at(t_exposure);
  motion.covariance = diagonal_covariance(0.01, 1e-4);
  motion.p_pivot_site_mm = Eigen::Vector3d(0, 0, 200);
  motion.inliers = 300;
  motion.inlier_spread = 0.7;
  motion.has_drift = true;
  motion.drift_um = 5;
  return motion;
}

inline ControlParameters healthy_parameters() {
  ControlParameters parameters;
  parameters.limits.frame_period = kFramePeriod;
  parameters.optics_are_fixed = true;
  return parameters;
}

class VirtualInputs {
 public:
  bool has_frames = true;     ///< the camera delivers
  bool has_estimates = true;  ///< the tracker delivers
  bool has_robot = true;
  safety::RegistrationInput registration = loaded_registration();

  /// Everything that arrives in (previous now, now]. Calls must go forward in time.
  [[nodiscard]] Readings at(safety::Timestamp now) {
    Readings readings;
    readings.registration = registration;
    for (; t_exposure(next_arrival_) + kReceivedAfter <= now; ++next_arrival_) {
      if (!has_frames || readings.arrival_count == Readings::kMaxArrivals) continue;
      FrameArrival& arrival = readings.arrivals[readings.arrival_count++];
      arrival.frame = next_arrival_;
      arrival.t_exposure = t_exposure(next_arrival_);
      arrival.t_received = arrival.t_exposure + kReceivedAfter;
    }
    for (; t_exposure(next_estimate_) + kPublishedAfter <= now; ++next_estimate_) {
      if (!has_estimates) continue;
      StampedEstimate& estimate = readings.estimate.emplace();
      estimate.motion = healthy_estimate(t_exposure(next_estimate_));
      estimate.registration_id = registration.id;
      estimate.frame = next_estimate_;
      estimate.t_frame_received = estimate.motion.t_exposure + kReceivedAfter;
      estimate.t_published = estimate.motion.t_exposure + kPublishedAfter;
    }
    if (has_robot) readings.robot_status = safety::RobotInput{true, now, false};
    return readings;
  }

 private:
  static safety::Timestamp t_exposure(std::uint64_t frame) {
    return kStart + static_cast<std::int64_t>(frame) * kFramePeriod;
  }
  static safety::RegistrationInput loaded_registration() {
    safety::RegistrationInput loaded;
    loaded.is_loaded = true;
    loaded.id = 4711;
    loaded.zoom = 1.25;
    loaded.focus_mm = 200;
    loaded.covariance = diagonal_covariance(0.05, 1e-3);
    loaded.p_target_site_mm = Eigen::Vector3d(3, 2, 205);
    loaded.T_site_ct.translation() = loaded.p_target_site_mm;  // the target is the ct origin
    return loaded;
  }
  std::uint64_t next_arrival_ = 1;
  std::uint64_t next_estimate_ = 1;
};

}  // namespace holdfast::rt::testing
