// SPDX-License-Identifier: Apache-2.0
// How a latched stop ends: the drift check, and the operator's two steps. Pure, noexcept,
// allocation-free.
#pragma once

#include "safety/gate.hpp"

namespace holdfast::safety {

/// The live image matches the keyframe of the loaded registration: an image exposed after `since`
/// has an estimate that is not lost, degraded or weak, within drift, displacement and rotation
/// limits, and no stop or hold reason is present but the robot's own (robot_fault, robot_silent).
[[nodiscard]] bool passes_drift_check(const Inputs& inputs, ReasonSet reasons,
                                      Timestamp since) noexcept;

/// Only images exposed after this say anything of the loaded registration: it was not there before,
/// or the optics were in doubt.
[[nodiscard]] Timestamp t_image_counts(const GateState& state) noexcept;

/// One cycle of the two steps, in mode stop_latched. True when they are complete in this cycle:
/// acknowledged, then confirmed between confirm_min and confirm_max later, both naming this stop,
/// no stop reason in between, and in this cycle the drift check passes on an image exposed after
/// the acknowledgement, and after every doubt about the optics, and no stop or hold reason is
/// present. Anything else that was tried starts the two steps anew.
[[nodiscard]] bool completes_acknowledgement(const Limits& limits, const Inputs& inputs,
                                             ReasonSet reasons, GateState& state) noexcept;

}  // namespace holdfast::safety
