// SPDX-License-Identifier: Apache-2.0
// Between the control thread and the recorder: every cycle's inputs and decision, and now and then
// the state, through two bounded queues. The control thread copies and goes on; when the recorder
// is behind, the cycle is not recorded, which its successor's index shows. Never waits.
#pragma once

#include <cstdint>

#include "rt/control_step.hpp"
#include "rt/core/cyclic_thread.hpp"
#include "rt/core/event_queue.hpp"

namespace holdfast::rt {

/// One cycle: control_step(t_decided, parameters, readings, state) gave output.
struct TapedCycle {
  CycleInfo info;
  safety::Timestamp t_decided{};  ///< the step's `now`
  safety::Timestamp t_done{};     ///< after the result was handed on
  Readings readings;
  ControlOutput output;
};

/// The state that cycle `after` left behind: the next one starts from it.
struct TapedState {
  std::uint64_t after = 0;
  ControlState state;
};

/// Allocates about 13 MB with itself; belongs on the heap.
class CycleTape {
 public:
  static constexpr std::size_t kCycles = 4096;  ///< the recorder may pause so long: 4 s at 1 kHz
  static constexpr std::uint64_t kStateEvery = 1000;  ///< cycles; where a replay can begin

  /// Control thread only, after the step. Two copies of about 3 kB, now and then a third.
  void record(const CycleInfo& info, safety::Timestamp t_decided, const Readings& readings,
              const ControlOutput& output, const ControlState& state) noexcept;

  /// Recorder thread only. False when there is none.
  [[nodiscard]] bool try_pop(TapedCycle& cycle) noexcept { return cycles_.try_pop(cycle); }
  /// Recorder thread only. When a cycle can be popped, the states after all earlier ones can be
  /// too.
  [[nodiscard]] bool try_pop(TapedState& state) noexcept { return states_.try_pop(state); }

  /// Cycles that were not taken up. Any thread.
  [[nodiscard]] std::uint64_t dropped() const noexcept { return cycles_.overflow_count(); }

 private:
  EventQueue<TapedCycle, kCycles> cycles_;
  EventQueue<TapedState, 16> states_;
  TapedCycle cycle_;  // control thread's
  TapedState state_;
  bool is_state_due_ = true;
};

}  // namespace holdfast::rt
