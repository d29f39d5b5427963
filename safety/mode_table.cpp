// SPDX-License-Identifier: Apache-2.0
#include "safety/mode_table.hpp"

namespace holdfast::safety {
namespace {

constexpr ReasonSet always_latching() noexcept {
  ReasonSet reasons;
  for (const Reason reason :
       {Reason::operator_stop, Reason::invalid_number, Reason::clock_step, Reason::loop_overrun,
        Reason::second_publisher, Reason::message_corrupt, Reason::internal_fault}) {
    reasons.insert(reason);
  }
  return reasons;
}

}  // namespace

std::string_view name(Mode mode) noexcept {
  switch (mode) {
    case Mode::init:
      return "init";
    case Mode::unregistered:
      return "unregistered";
    case Mode::ready:
      return "ready";
    case Mode::permitted:
      return "permitted";
    case Mode::hold:
      return "hold";
    case Mode::stop_latched:
      return "stop_latched";
  }
  return "unknown";
}

std::string_view name(Condition condition) noexcept {
  switch (condition) {
    case Condition::latching_fault:
      return "latching_fault";
    case Condition::inputs_arrived:
      return "inputs_arrived";
    case Condition::verified:
      return "verified";
    case Condition::verification_withdrawn:
      return "verification_withdrawn";
    case Condition::armed:
      return "armed";
    case Condition::disarmed:
      return "disarmed";
    case Condition::hold_reason:
      return "hold_reason";
    case Condition::recovered:
      return "recovered";
    case Condition::released:
      return "released";
  }
  return "unknown";
}

Mode next_mode(Mode mode, ConditionSet conditions) noexcept {
  for (const Transition& transition : kTransitions) {
    if (transition.from == mode && conditions.contains(transition.when)) return transition.to;
  }
  return mode;
}

ReasonSet latching_reasons(Mode mode, ReasonSet reasons) noexcept {
  const ReasonSet stops = reasons.with(Severity::stop);
  if (mode == Mode::permitted || mode == Mode::hold) return stops;
  if (mode == Mode::stop_latched) return ReasonSet{};
  return ReasonSet(stops.bits() & always_latching().bits());
}

}  // namespace holdfast::safety
