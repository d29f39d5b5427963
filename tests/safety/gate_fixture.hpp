// SPDX-License-Identifier: Apache-2.0
// The gate brought into any mode, and the faults that several suites begin with.
#pragma once

#include <gtest/gtest.h>

#include "tests/safety/good_inputs.hpp"

namespace holdfast::safety::test {

inline void dark_frame(Inputs& inputs) {
  inputs.camera.faults.insert(Reason::frame_dark);
}
inline void lose_tracking(Inputs& inputs) {
  inputs.tracking.is_lost = true;
}
inline void drift(Inputs& inputs) {
  inputs.tracking.drift_mm = 1;
}

class GateTest : public ::testing::Test, public GateDriver {
 protected:
  /// Brings the gate into `mode` by inputs and commands alone.
  void to(Mode mode) {
    if (mode == Mode::init) return;
    if (mode == Mode::unregistered) step([](Inputs& in) { in.registration.is_loaded = false; });
    if (mode == Mode::ready) to_ready();
    if (mode > Mode::ready) to_permitted();
    if (mode == Mode::hold) step(dark_frame);
    if (mode == Mode::stop_latched) command(Command::stop);
    ASSERT_EQ(state.mode, mode);
  }
};

}  // namespace holdfast::safety::test
