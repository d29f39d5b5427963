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

/// invalid_number, for everything that will be used: transforms, covariances, speed, drift, spread,
/// scale, zoom, focus. Of an absent prediction, an absent or lost estimate, or no registration
/// nothing is read.
[[nodiscard]] ReasonSet number_reasons(const Inputs& inputs) noexcept;

/// registration_changed (against the verified one in `state`).
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

/// Every reason to doubt that zoom and focus are those of the registration: what optics_reasons
/// may return.
inline constexpr ReasonSet kOpticsReasons = [] {
  ReasonSet reasons;
  for (const Reason reason :
       {Reason::optics_changed, Reason::scale_mismatch, Reason::microscope_missing,
        Reason::microscope_not_operational, Reason::microscope_silent, Reason::microscope_corrupt,
        Reason::can_bus_off, Reason::can_error_passive, Reason::can_overflow, Reason::can_down,
        Reason::optics_moving}) {
    reasons.insert(reason);
  }
  return reasons;
}();

/// optics_changed, scale_mismatch, optics_moving, microscope_*, can_*. Encoders that are watched
/// are believed only while the report is fresh and without a fault. The scale of an estimate that
/// is not lost must be that of the encoder's zoom over the registration's; 1 for fixed optics and
/// while the zoom is not known. A fault that is none of the microscope's is an internal_fault.
[[nodiscard]] ReasonSet optics_reasons(const Limits& limits, const Inputs& inputs) noexcept;

/// All of the above.
[[nodiscard]] ReasonSet observed_reasons(const Limits& limits, const Inputs& inputs,
                                         const GateState& state) noexcept;

}  // namespace holdfast::safety
