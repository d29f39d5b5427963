// SPDX-License-Identifier: Apache-2.0
// What a recording holds: one ROS 2 message type per topic, described so that every member of the
// control step's inputs, state and outputs is in it. A member that is added elsewhere and not here
// does not compile. docs/recording.md explains the topics.
#pragma once

#include "bridge/recorder/ros2_message.hpp"
#include "rt/cycle_tape.hpp"

namespace holdfast::rt {

/// Once at the start of every file.
struct RecordedSession {
  std::string version;     ///< of holdfastd
  std::uint64_t run = 0;   ///< UTC of the daemon's start, ns: the same in all files of one run
  std::uint64_t part = 0;  ///< file of that run, from 0
  std::chrono::nanoseconds t_begun{};       ///< when this file was begun
  std::int64_t utc_minus_monotonic_ns = 0;  ///< at the start; log times are monotonic + this
  std::chrono::nanoseconds loop_period{};
  std::string registration_checksum, ct;
  double zoom = 0, focus_mm = 0;
  Eigen::Vector3d p_target_ct_mm = Eigen::Vector3d::Zero();
  ControlParameters parameters;
};

/// The registration as the control step sees it: at the start of a file and when it has changed.
struct RecordedRegistration {
  std::uint64_t from_cycle = 0;
  safety::RegistrationInput registration;
};

/// Every cycle: what the control step was given, but the registration.
struct RecordedInput {
  std::uint64_t cycle = 0;
  std::chrono::nanoseconds t_scheduled{}, t_woken{}, t_decided{}, t_done{};
  std::uint64_t missed = 0;
  Readings readings;
};

struct RecordedPose {
  Eigen::Isometry3d T_robot_ct = Eigen::Isometry3d::Identity();
  safety::Matrix6d covariance = safety::Matrix6d::Zero();
  std::chrono::nanoseconds t_pose{}, validity{};
  std::uint64_t registration_id = 0;
};

/// Every cycle: what the control step made of it.
struct RecordedDecision {
  std::uint64_t cycle = 0;
  safety::Mode mode = safety::Mode::init;
  safety::Reason cause = safety::Reason::initialising;
  safety::ReasonSet reasons;
  bool changed = false;
  std::uint32_t stop_id = 0;
  std::optional<RecordedPose> approved;
  std::optional<safety::PredictedPose> prediction;
  double sigma_target_mm = 0;
  std::chrono::nanoseconds t_evidence{};
  std::uint64_t frame = 0;
  std::chrono::nanoseconds t_exposure{}, t_frame_received{};
};

/// Cycles that are missing between two recorded ones.
struct RecordedGap {
  std::uint64_t first_cycle = 0, count = 0;
};

struct RecordedTime {
  std::int32_t sec = 0;
  std::uint32_t nanosec = 0;
};

/// rcl_interfaces/Log, which Foxglove shows as a log: each change of mode or cause.
struct RecordedLog {
  RecordedTime stamp;       ///< UTC
  std::uint8_t level = 20;  ///< 20 info, 30 warning
  std::string name, text, file, function;
  std::uint32_t line = 0;
};

[[nodiscard]] RecordedInput recorded_input(const TapedCycle& cycle);
[[nodiscard]] RecordedDecision recorded_decision(std::uint64_t cycle, const ControlOutput& output);

inline constexpr std::string_view kSessionTopic = "/holdfast/session";
inline constexpr std::string_view kRegistrationTopic = "/holdfast/registration";
inline constexpr std::string_view kStateTopic = "/holdfast/state";
inline constexpr std::string_view kInputTopic = "/holdfast/input";
inline constexpr std::string_view kDecisionTopic = "/holdfast/decision";
inline constexpr std::string_view kGapTopic = "/holdfast/gap";
inline constexpr std::string_view kLogTopic = "/holdfast/log";

}  // namespace holdfast::rt
