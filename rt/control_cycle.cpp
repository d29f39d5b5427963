// SPDX-License-Identifier: Apache-2.0
#include "rt/control_cycle.hpp"

#include <algorithm>

#include "rt/core/clock.hpp"

namespace holdfast::rt {

ControlCycle::ControlCycle(const ControlParameters& parameters,
                           const safety::RegistrationInput& registration, FrameArrivals& arrivals,
                           Mailbox<StampedEstimate>& estimates, ControlInbox& inbox,
                           CycleTape* tape)
    : parameters_(parameters),
      arrivals_(arrivals),
      estimates_(estimates),
      inbox_(inbox),
      tape_(tape) {
  readings_.registration = registration;
}

void ControlCycle::run(const CycleInfo& info) noexcept {
  read_inputs(info);
  const safety::Timestamp now = monotonic_now();
  const ControlOutput output = control_step(now, parameters_, readings_, state_);
  account(info, output);
  // The withdrawal is raised before the report: a publisher that sees the report sees it too.
  if (!output.decision.approved) withdrawals_.raise(output.decision.reasons.bits(), report_.cycles);
  report_.step_max = std::max(report_.step_max, monotonic_now() - now);
  reports_.publish(report_);
  if (tape_ != nullptr) tape_->record(info, now, readings_, output, state_);
}

void ControlCycle::read_inputs(const CycleInfo& info) noexcept {
  readings_.arrival_count = 0;
  while (readings_.arrival_count < Readings::kMaxArrivals &&
         arrivals_.try_pop(readings_.arrivals[readings_.arrival_count]))
    ++readings_.arrival_count;

  StampedEstimate estimate;
  readings_.estimate.reset();
  if (estimates_.try_take(estimate)) readings_.estimate = estimate;

  safety::RobotInput robot;
  readings_.robot_status.reset();
  if (inbox_.robot_status.try_take(robot)) readings_.robot_status = robot;

  safety::OpticsInput optics;
  readings_.optics.reset();
  if (inbox_.optics.newest.try_take(optics)) readings_.optics = optics;

  readings_.operator_command = {};
  (void)inbox_.commands.try_pop(readings_.operator_command);

  const std::uint64_t overflows = arrivals_.overflow_count() + inbox_.commands.overflow_count();
  readings_.loop.internal_fault = overflows != overflows_seen_;
  overflows_seen_ = overflows;
  readings_.loop.wake_lateness = info.lateness;
  readings_.loop.clock_divergence = clock_divergence();
  // Relaxed: a flag without data; seen a cycle later at worst.
  readings_.loop.message_corrupt =
      inbox_.message_corrupt.exchange(false, std::memory_order_relaxed);
  readings_.loop.second_publisher = inbox_.second_publisher.load(std::memory_order_relaxed);
}

/// How far UTC has parted from monotonic time since the previous cycle, beyond what a preemption
/// between reading the two clocks can explain.
safety::Duration ControlCycle::clock_divergence() noexcept {
  const std::chrono::nanoseconds before = monotonic_now();
  const std::chrono::nanoseconds utc = utc_now();
  const std::chrono::nanoseconds doubt = monotonic_now() - before;
  const std::chrono::nanoseconds offset = utc - before;
  const std::chrono::nanoseconds parted = std::chrono::abs(offset - clock_offset_);
  const std::chrono::nanoseconds explained = doubt + clock_offset_doubt_;
  const bool is_first = !has_clock_offset_;
  has_clock_offset_ = true;
  clock_offset_ = offset;
  clock_offset_doubt_ = doubt;
  return is_first ? safety::Duration{} : std::max(parted - explained, safety::Duration{});
}

void ControlCycle::account(const CycleInfo& info, const ControlOutput& output) noexcept {
  report_.output = output;
  if (output.decision.changed) report_.t_changed = monotonic_now();
  report_.cycles = info.index + 1;
  report_.cycles_missed = info.missed;
  report_.wake_lateness_max = std::max(report_.wake_lateness_max, info.lateness);
}

}  // namespace holdfast::rt
