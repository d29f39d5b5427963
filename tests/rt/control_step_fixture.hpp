// SPDX-License-Identifier: Apache-2.0
// The control step driven at 1 kHz by healthy inputs, of which a test spoils what it is about.
#pragma once

#include <gtest/gtest.h>

#include "tests/rt/virtual_inputs.hpp"

namespace holdfast::rt::testing {

inline constexpr safety::Duration kPeriod = milliseconds(1);

class ControlStep : public ::testing::Test {
 public:
  /// One cycle at 1 kHz; `spoil` may change the readings first.
  template <typename Spoil>
  ControlOutput cycle(Spoil spoil) {
    now += kPeriod;
    Readings readings = inputs.at(now);
    spoil(readings);
    output = control_step(now, parameters, readings, state);
    return output;
  }
  ControlOutput cycle() {
    return cycle([](Readings&) {});
  }
  void run(safety::Duration time) {
    for (const safety::Timestamp end = now + time; now < end;) cycle();
  }
  /// Goes on until the cycle in which the next estimate arrives, and spoils that one.
  template <typename Spoil>
  ControlOutput spoil_next_estimate(Spoil spoil) {
    for (bool is_done = false; !is_done;) {
      cycle([&](Readings& readings) {
        if (!readings.estimate) return;
        spoil(*readings.estimate);
        is_done = true;
      });
    }
    return output;
  }
  void restart() {
    parameters = healthy_parameters();
    inputs = {};
    state = {};
    now = kStart;
    output = {};
  }
  void reach_permitted() {
    run(milliseconds(500));
    ASSERT_EQ(output.decision.mode, safety::Mode::ready);
    cycle([](Readings& readings) { readings.operator_command.command = safety::Command::arm; });
    ASSERT_EQ(output.decision.mode, safety::Mode::permitted);
  }

  ControlParameters parameters = healthy_parameters();
  VirtualInputs inputs;
  ControlState state;
  safety::Timestamp now = kStart;
  ControlOutput output;
};

}  // namespace holdfast::rt::testing
