// SPDX-License-Identifier: Apache-2.0
// Every fault in every mode.
#include <gtest/gtest.h>

#include "safety/gate.hpp"
#include "safety/mode_table.hpp"
#include "safety/monitors.hpp"
#include "tests/safety/faults.hpp"
#include "tests/safety/gate_fixture.hpp"

namespace holdfast::safety {
namespace {

using std::chrono::nanoseconds;
using test::GateTest;

class EveryFault : public GateTest, public ::testing::WithParamInterface<test::Fault> {
 protected:
  void SetUp() override { RecordProperty("requirement", GetParam().requirement); }
  Decision inject() {
    return step([&](Inputs& inputs) { GetParam().inject(inputs, limits); });
  }
};
const auto kFaultName = [](const auto& info) { return info.param.name; };
INSTANTIATE_TEST_SUITE_P(Gate, EveryFault, ::testing::ValuesIn(test::all_faults()), kFaultName);

TEST_P(EveryFault, WithdrawsPermissionInTheSameCycle) {
  const bool is_stop = severity(GetParam().reason) == Severity::stop;
  for (const Mode mode : {Mode::permitted, Mode::hold}) {
    state = GateState{};
    to(mode);
    const Decision decision = inject();
    EXPECT_EQ(decision.mode, is_stop ? Mode::stop_latched : Mode::hold) << name(mode);
    EXPECT_EQ(name(decision.cause), name(GetParam().reason)) << name(mode);
    EXPECT_FALSE(decision.approved) << name(mode);
    EXPECT_EQ(decision.stop_id, is_stop ? 1U : 0U) << name(mode);
  }
}

TEST_P(EveryFault, LatchesBeforePermissionOnlyIfItPutsTheSystemInDoubt) {
  ReasonSet reason;
  reason.insert(GetParam().reason);
  const bool latches = !latching_reasons(Mode::ready, reason).empty();
  const bool voids_verification = (reason.bits() & kOpticsReasons.bits()) != 0;
  for (const Mode mode : {Mode::unregistered, Mode::ready}) {
    state = GateState{};
    to(mode);
    const Decision decision = step([&](Inputs& inputs) {
      GetParam().inject(inputs, limits);
      inputs.tracking.is_new = false;
    });
    const Mode before = voids_verification ? Mode::unregistered : mode;
    EXPECT_EQ(decision.mode, latches ? Mode::stop_latched : before) << name(mode);
    EXPECT_TRUE(decision.reasons.contains(GetParam().reason)) << name(mode);
    EXPECT_NE(decision.cause, Reason::none);
  }
}

TEST_P(EveryFault, KeepsItFromBeingArmed) {
  to_ready();
  const Decision decision = step([&](Inputs& inputs) {
    inputs.operator_command.command = Command::arm;
    GetParam().inject(inputs, limits);
  });
  EXPECT_NE(decision.mode, Mode::permitted);
  EXPECT_FALSE(decision.approved);
  // By the gate's own rule, not by its last look at itself, which would have stopped it.
  EXPECT_EQ(decision.reasons.contains(Reason::internal_fault),
            GetParam().reason == Reason::internal_fault);
}

TEST_P(EveryFault, PreventsTheEndOfALatchedStop) {
  to(Mode::stop_latched);
  command(Command::acknowledge, 1);
  run(limits.confirm_min);
  const Decision decision = step([&](Inputs& inputs) {
    inputs.operator_command = {Command::confirm, 1};
    GetParam().inject(inputs, limits);
  });
  EXPECT_EQ(decision.mode, Mode::stop_latched);
  EXPECT_EQ(decision.cause, Reason::operator_stop);  // the one it was latched for
}

TEST_F(GateTest, ClockGoingBackwardsLatchesInEveryMode) {
  RecordProperty("requirement", "SR-13");
  for (const Mode mode : {Mode::unregistered, Mode::ready, Mode::permitted, Mode::hold}) {
    state = GateState{};
    to(mode);
    const Decision decision = step({}, -nanoseconds(1));
    EXPECT_EQ(decision.mode, Mode::stop_latched) << name(mode);
    EXPECT_EQ(decision.cause, Reason::clock_step) << name(mode);
  }
}

TEST_F(GateTest, OperatorStopLatchesInInit) {
  RecordProperty("requirement", "SR-21");
  EXPECT_EQ(command(Command::stop).mode, Mode::stop_latched);
}

TEST_F(GateTest, NamesTheLowestCodeOfSimultaneousFaults) {
  RecordProperty("requirement", "SR-27");
  to_permitted();
  const Decision decision = step([](Inputs& in) {
    in.loop.internal_fault = true;
    in.tracking.contradicts_filter = true;
    in.tracking.drift_mm = 1;
    in.camera.is_connected = false;
  });
  EXPECT_EQ(decision.cause, Reason::drift_exceeded);
  for (const Reason reason : {Reason::drift_exceeded, Reason::pose_jump, Reason::internal_fault,
                              Reason::camera_disconnected}) {
    EXPECT_TRUE(decision.reasons.contains(reason)) << name(reason);
  }
}

}  // namespace
}  // namespace holdfast::safety
