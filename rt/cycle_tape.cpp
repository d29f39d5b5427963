// SPDX-License-Identifier: Apache-2.0
#include "rt/cycle_tape.hpp"

#include "rt/core/clock.hpp"

namespace holdfast::rt {

void CycleTape::record(const CycleInfo& info, safety::Timestamp t_decided, const Readings& readings,
                       const ControlOutput& output, const ControlState& state) noexcept {
  cycle_.info = info;
  cycle_.t_decided = t_decided;
  cycle_.t_done = monotonic_now();
  cycle_.readings = readings;
  cycle_.output = output;
  // After a cycle that is not on the tape a replay needs a state to go on from.
  if (!cycles_.try_push(cycle_)) {
    is_state_due_ = true;
    return;
  }
  if (!is_state_due_ && (info.index + 1) % kStateEvery != 0) return;
  state_.after = info.index;
  state_.state = state;
  is_state_due_ = !states_.try_push(state_);
}

}  // namespace holdfast::rt
