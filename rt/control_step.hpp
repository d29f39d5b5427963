// SPDX-License-Identifier: Apache-2.0
// The control step: (time, parameters, readings, state) -> (output, state). A pure function: no
// clock, no I/O, no heap, no locks, no logging, noexcept. It fuses stamped motion estimates in a
// constant-velocity filter, predicts the site's pose to now + Limits::pose_lead, and asks the gate.
//
// The prediction's covariance and speed are about RegistrationInput::p_target_site_mm: the filter's
// error (dq, dtheta) about the pivot becomes (dq + dtheta x lever, dtheta) with the lever from
// pivot to target in camera axes. Without a registration there is no target; then it is the pivot.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <optional>

#include "perception/motion_estimate.hpp"
#include "rt/pose_filter.hpp"
#include "safety/gate.hpp"

namespace holdfast::rt {

struct ControlParameters {
  safety::Limits limits;
  PoseFilterParameters filter;
  Eigen::Isometry3d T_robot_camera = Eigen::Isometry3d::Identity();
  safety::HandEyeSigma hand_eye_sigma;
  bool optics_are_fixed = false;  ///< declared; else the microscope must be heard
  safety::ReasonSet advisories;   ///< not_real_time, unsecured_transport, ...
};

/// One frame's arrival, reported by the camera thread at once, before tracking.
struct FrameArrival {
  std::uint64_t frame = 0;
  safety::Timestamp t_received{};
  safety::Timestamp t_exposure{};
  safety::ReasonSet faults;  ///< frame_* and camera_*; a camera_disconnected event has no frame
  bool is_connected = true;
  bool is_frame = true;  ///< a complete frame; false: an event without one (gap, silent, connected)
};

struct StampedEstimate {
  perception::MotionEstimate motion;
  std::uint64_t registration_id = 0;  ///< whose keyframe the motion is measured against
  std::uint64_t frame = 0;
  safety::Timestamp t_frame_received{};
  safety::Timestamp t_published{};  ///< when the tracker handed it over
};

/// Everything that arrived since the previous cycle.
struct Readings {
  static constexpr std::size_t kMaxArrivals = 8;
  std::array<FrameArrival, kMaxArrivals> arrivals{};
  std::size_t arrival_count = 0;  ///< more than kMaxArrivals is an internal fault
  std::optional<StampedEstimate> estimate;
  safety::RegistrationInput registration;
  std::optional<safety::RobotInput> robot_status;  ///< newest accepted status
  std::optional<safety::OpticsInput> optics;       ///< newest look at the microscope
  safety::OperatorInput operator_command;
  safety::LoopInput loop;
};

struct ControlState {
  safety::GateState gate;
  PoseFilter filter;
  safety::CameraInput camera;
  safety::TrackingInput tracking;
  safety::RobotInput robot;
  safety::OpticsInput optics;
  std::uint64_t registration_id = 0;  ///< the one that filter and estimates belong to
  bool has_registration = false;
  std::uint64_t newest_frame = 0;  ///< of the newest estimate
  safety::Timestamp t_newest_frame_received{};
  safety::Timestamp t_estimate_published{};
  safety::Timestamp t_evidence{};
};

struct ControlOutput {
  safety::Decision decision;
  std::optional<safety::PredictedPose> prediction;  ///< also when not permitted; for display only
  /// What the gate judged: 1 sigma of the target's position, largest axis, of prediction,
  /// registration and hand-eye calibration; NaN without a prediction or a registration.
  double sigma_target_mm = std::numeric_limits<double>::quiet_NaN();
  /// When what led to the present mode and cause was there to be seen: arrival of the faulty input,
  /// or the deadline that passed. Kept until mode or cause change; never after now.
  safety::Timestamp t_evidence{};
  std::uint64_t frame = 0;  ///< of the newest estimate used
  safety::Timestamp t_exposure{};
  safety::Timestamp t_frame_received{};
};

/// One cycle. Everything wrong with the readings ends as a reason of the decision:
/// - faults of all arrivals count, however many came since the previous cycle;
/// - a lost estimate does not correct the filter; a degraded one does, and is marked;
/// - one measured against another keyframe than the registration's is not taken in (tracking_lost);
/// - one that contradicts the filter is not taken in (pose_jump); should all that follow contradict
///   too, the filter starts anew after PoseFilterParameters::gap_max, long after the gate latched;
/// - one that is older than its predecessor is dropped (frame_time_invalid); one that is not a
///   number likewise (invalid_number); one from the future is not taken in;
/// - a registration that comes, goes or changes brings its own keyframe: the filter starts anew.
/// Same arguments, same result, bit for bit.
[[nodiscard]] ControlOutput control_step(safety::Timestamp now, const ControlParameters& parameters,
                                         const Readings& readings, ControlState& state) noexcept;

}  // namespace holdfast::rt
