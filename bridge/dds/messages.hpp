// SPDX-License-Identifier: Apache-2.0
// From the house's types to messages and back: plain conversions, no decisions. Protection is not
// filled in here; the writers do it as a message goes out. noexcept and allocation-free.
#pragma once

#include <cstdint>
#include <string_view>

#include <Eigen/Geometry>

#include "bridge/dds/endpoint.hpp"
#include "bridge/dds/message_types.hpp"
#include "perception/motion_estimate.hpp"
#include "safety/gate.hpp"

namespace holdfast::bridge::dds {

/// What stands behind a pose, for the receiver to trace it. Times on CLOCK_MONOTONIC.
struct PoseOrigin {
  std::uint64_t frame = 0;                                      ///< id of the newest frame used
  safety::Timestamp t_exposure{};                               ///< its mid-exposure
  safety::Timestamp t_frame_received{};                         ///< its arrival
  Eigen::Vector3d p_target_robot_mm = Eigen::Vector3d::Zero();  ///< where the target is now
};

[[nodiscard]] msg::CompensatedPose to_message(const safety::ApprovedPose& pose,
                                              const PoseOrigin& origin) noexcept;

/// `t_changed`: when mode or cause last changed; `t_evidence`: arrival of the input behind the
/// decision, or the deadline that passed. Both on CLOCK_MONOTONIC.
[[nodiscard]] msg::MotionStop to_message(const safety::Decision& decision,
                                         safety::Timestamp t_changed,
                                         safety::Timestamp t_evidence) noexcept;

/// What TrackingHealth says beside the estimate itself.
struct HealthFigures {
  std::uint64_t frame = 0;
  std::uint64_t registration_id = 0;  ///< whose keyframe the estimate is measured against
  double sigma_target_mm = 0;         ///< as the gate judged it
  double clock_offset_sigma_us = 0;
  std::uint64_t frames_received = 0, frames_incomplete = 0, frames_missing = 0, frames_skipped = 0;
  std::uint64_t cycles = 0, cycles_missed = 0;
  std::uint32_t wake_lateness_max_us = 0, step_max_us = 0;
  safety::ReasonSet advisories;
};
/// On `lost` the motion's numbers are sent as NaN: none may be used.
[[nodiscard]] msg::TrackingHealth to_message(const perception::MotionEstimate& estimate,
                                             const HealthFigures& figures) noexcept;

/// Texts longer than 64 characters are cut. Not loaded: every number is zero.
[[nodiscard]] msg::RegistrationInfo to_message(const safety::RegistrationInput& registration,
                                               double zoom, double focus_mm,
                                               std::string_view ct_identity,
                                               std::string_view checksum) noexcept;

[[nodiscard]] safety::RobotInput to_input(const msg::RobotStatus& status,
                                          safety::Timestamp t_received) noexcept;

/// A command code that is not in safety::Command becomes Command::stop: a corrupt or newer console
/// must not be ignored.
[[nodiscard]] safety::OperatorInput to_input(const msg::OperatorCommand& command) noexcept;

/// The one exit for poses: publishes nothing but what the gate approved. One thread.
class PosePublisher {
 public:
  PosePublisher(const Participant& participant, std::uint32_t source)
      : writer_(participant, source, PoseWriterKey{}) {}
  /// With the pose's own validity. False when the middleware did not take it.
  [[nodiscard]] bool publish(const safety::ApprovedPose& pose, const PoseOrigin& origin) noexcept;
  [[nodiscard]] EndpointStatus status() const noexcept { return writer_.status(); }

 private:
  ProtectedWriter<msg::CompensatedPose> writer_;
};

}  // namespace holdfast::bridge::dds
