// SPDX-License-Identifier: Apache-2.0
// The monitors: what is wrong in this cycle, judged from limits and inputs alone, whatever the
// mode. Each returns the reasons it found; none decides. A value exactly at its limit passes; NaN
// never does. Pure, noexcept, allocation-free.
#pragma once

#include "safety/gate.hpp"

namespace holdfast::safety {

/// operator_stop; message_corrupt for a command that does not exist.
[[nodiscard]] ReasonSet operator_reasons(const OperatorInput& command) noexcept;

/// clock_step, loop_overrun. `state` gives the previous cycle's time.
[[nodiscard]] ReasonSet time_reasons(const Limits& limits, const Inputs& inputs,
                                     const GateState& state) noexcept;

/// second_publisher, message_corrupt, internal_fault, as reported to the loop.
[[nodiscard]] ReasonSet report_reasons(const LoopInput& loop) noexcept;

/// invalid_number, for everything that will be used: transforms, covariances, speed, drift, spread.
/// Of an absent prediction, an absent or lost estimate, or no registration nothing is read.
[[nodiscard]] ReasonSet number_reasons(const Inputs& inputs) noexcept;

/// registration_changed (against the verified one in `state`), optics_changed.
[[nodiscard]] ReasonSet registration_reasons(const RegistrationInput& registration,
                                             const GateState& state) noexcept;

/// tracking_lost for an estimate measured against another keyframe than the registration's: of the
/// site that is registered it says nothing.
[[nodiscard]] ReasonSet keyframe_reasons(const RegistrationInput& registration,
                                         const TrackingInput& tracking) noexcept;

/// camera_*, frame_*: faults as reported, frame_late, frame_time_invalid. A fault that is none of
/// the camera's to report is an internal_fault.
[[nodiscard]] ReasonSet camera_reasons(const Limits& limits, const CameraInput& camera,
                                       Timestamp now) noexcept;

/// tracking_*, estimate_stale, frame_time_invalid, pose_jump, drift_exceeded.
[[nodiscard]] ReasonSet tracking_reasons(const Limits& limits, const TrackingInput& tracking,
                                         Timestamp now) noexcept;

/// displacement_exceeded, speed_exceeded, covariance_exceeded; tracking_lost without a prediction.
/// Without a registration there is no target to judge, and of an estimate too old to extrapolate
/// from (estimate_stale) the extrapolated motion says nothing: then none.
[[nodiscard]] ReasonSet motion_reasons(const Limits& limits, const Inputs& inputs) noexcept;

/// robot_fault, robot_silent.
[[nodiscard]] ReasonSet robot_reasons(const Limits& limits, const RobotInput& robot,
                                      Timestamp now) noexcept;

/// All of the above.
[[nodiscard]] ReasonSet observed_reasons(const Limits& limits, const Inputs& inputs,
                                         const GateState& state) noexcept;

}  // namespace holdfast::safety
