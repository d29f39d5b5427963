// SPDX-License-Identifier: Apache-2.0
#include "bridge/dds/inputs.hpp"

#include "bridge/dds/messages.hpp"

namespace holdfast::bridge::dds {
namespace {

template <class M>
safety::ReceiverParameters receiver_parameters(safety::ClockRelation clock,
                                               std::uint32_t max_counter_step) {
  safety::ReceiverParameters parameters;
  parameters.clock = clock;
  parameters.max_counter_step = max_counter_step;
  parameters.max_validity = Topic<M>::policy().validity;
  return parameters;
}

// A lost status is made up for by the next; their absence is the gate's to judge (robot_silent). A
// lost command is not: the operator meant something that did not happen.
constexpr std::uint32_t kStatusStep = 10;
constexpr std::uint32_t kCommandStep = 1;

}  // namespace

InputReader::InputReader(const Participant& participant, safety::ClockRelation clock)
    : robot_(participant, receiver_parameters<msg::RobotStatus>(clock, kStatusStep)),
      operator_(participant, receiver_parameters<msg::OperatorCommand>(clock, kCommandStep)) {}

ReceivedInputs InputReader::poll() noexcept {
  ReceivedInputs result;
  robot_.take([&](const msg::RobotStatus& message, safety::Verdict verdict, Clocks now) {
    if (verdict != safety::Verdict::accepted) {
      result.is_corrupt = true;
      return;
    }
    const bool had_fault = result.robot && result.robot->has_fault;
    result.robot = to_input(message, now.monotonic);
    result.robot->has_fault = result.robot->has_fault || had_fault;
  });
  operator_.take([&](const msg::OperatorCommand& message, safety::Verdict verdict, Clocks) {
    if (verdict != safety::Verdict::accepted || result.command_count_ == result.commands_.size()) {
      result.is_corrupt = true;
      return;
    }
    result.commands_[result.command_count_++] = to_input(message);
  });
  return result;
}

}  // namespace holdfast::bridge::dds
