// SPDX-License-Identifier: Apache-2.0
// The control step: (time, parameters, readings, state) -> (output, state). A pure function: no
// clock, no I/O, no heap, no locks, no logging, noexcept. It fuses stamped motion estimates in a
// constant-velocity filter, predicts the site's pose to now, and asks the gate.
#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include "perception/motion_estimate.hpp"
#include "rt/pose_filter.hpp"
#include "safety/gate.hpp"

namespace holdfast::rt {

struct ControlParameters {
  safety::Limits limits;
  PoseFilterParameters filter;
  Eigen::Isometry3d T_robot_camera = Eigen::Isometry3d::Identity();
  safety::ReasonSet advisories;  ///< not_real_time, unsecured_transport
};

/// One frame's arrival, reported by the camera thread at once, before tracking.
struct FrameArrival {
  std::uint64_t frame = 0;
  safety::Timestamp t_received{};
  safety::Timestamp t_exposure{};
  safety::ReasonSet faults;  ///< frame_* and camera_*; a camera_disconnected event has no frame
  bool is_connected = true;
  bool is_frame = true;  ///< a complete frame; false: only an event (gap, incomplete, disconnected)
};

struct StampedEstimate {
  perception::MotionEstimate motion;
  std::uint64_t frame = 0;
  safety::Timestamp t_frame_received{};
  safety::Timestamp t_published{};  ///< when the tracker handed it over
};

/// Everything that arrived since the previous cycle.
struct Readings {
  static constexpr std::size_t kMaxArrivals = 8;
  std::array<FrameArrival, kMaxArrivals> arrivals{};
  std::size_t arrival_count = 0;
  std::optional<StampedEstimate> estimate;
  safety::RegistrationInput registration;
  std::optional<safety::RobotInput> robot_status;  ///< newest accepted status
  safety::OperatorInput operator_command;
  safety::LoopInput loop;
};

struct ControlState {
  safety::GateState gate;
  PoseFilter filter;
  safety::CameraInput camera;
  safety::TrackingInput tracking;
  safety::RobotInput robot;
  std::uint64_t newest_frame = 0;
  safety::Timestamp t_newest_frame_received{};
  safety::Timestamp t_evidence{};
};

struct ControlOutput {
  safety::Decision decision;
  std::optional<safety::PredictedPose> prediction;  ///< also when not permitted; for display only
  double sigma_target_mm = 0;                       ///< of the prediction
  safety::Timestamp t_evidence{};  ///< arrival of the faulty input, or the deadline that passed
  std::uint64_t frame = 0;         ///< of the newest estimate used
  safety::Timestamp t_exposure{};
  safety::Timestamp t_frame_received{};
};

[[nodiscard]] ControlOutput control_step(safety::Timestamp now, const ControlParameters& parameters,
                                         const Readings& readings, ControlState& state) noexcept;

}  // namespace holdfast::rt
