// SPDX-License-Identifier: Apache-2.0
#include "safety/acknowledgement.hpp"

#include <algorithm>

#include "safety/numbers.hpp"

namespace holdfast::safety {
namespace {

bool has_fault(ReasonSet reasons) noexcept {
  return !reasons.with(Severity::stop).empty() || !reasons.with(Severity::hold).empty();
}

bool is_confirmed(const Limits& limits, const Inputs& inputs, ReasonSet reasons,
                  const GateState& state) noexcept {
  const Duration since_acknowledged = elapsed(state.t_acknowledged, inputs.now);
  return inputs.operator_command.stop_id == state.stop_id &&
         since_acknowledged >= limits.confirm_min && since_acknowledged <= limits.confirm_max &&
         !has_fault(reasons) && !state.is_awaiting_good_frame &&
         passes_drift_check(inputs, reasons, std::max(state.t_acknowledged, t_image_counts(state)));
}

}  // namespace

Timestamp t_image_counts(const GateState& state) noexcept {
  return std::max(state.t_registration_seen, state.t_optics_doubted);
}

bool passes_drift_check(const Inputs& inputs, ReasonSet reasons, Timestamp since) noexcept {
  // The limits on drift, displacement, inliers and age have been judged by the monitors.
  reasons.erase(Reason::robot_fault);
  reasons.erase(Reason::robot_silent);
  return inputs.registration.is_loaded && inputs.prediction.has_value() &&
         inputs.tracking.has_estimate && inputs.tracking.t_exposure > since && !has_fault(reasons);
}

bool completes_acknowledgement(const Limits& limits, const Inputs& inputs, ReasonSet reasons,
                               GateState& state) noexcept {
  const OperatorInput& command = inputs.operator_command;
  if (!reasons.with(Severity::stop).empty()) {
    state.is_acknowledged = false;
    return false;
  }
  if (command.command == Command::acknowledge) {
    state.is_acknowledged = command.stop_id == state.stop_id;
    state.t_acknowledged = inputs.now;
    return false;
  }
  if (command.command != Command::confirm) return false;
  const bool is_complete = state.is_acknowledged && is_confirmed(limits, inputs, reasons, state);
  state.is_acknowledged = false;
  return is_complete;
}

}  // namespace holdfast::safety
