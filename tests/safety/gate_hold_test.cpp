// SPDX-License-Identifier: Apache-2.0
// A hold: how it recovers, and when it becomes a stop.
#include <gtest/gtest.h>

#include "safety/gate.hpp"
#include "tests/safety/gate_fixture.hpp"

namespace holdfast::safety {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using test::dark_frame;
using test::GateTest;
using test::lose_tracking;

TEST_F(GateTest, HoldRecoversAfterBeingWellLongEnough) {
  RecordProperty("requirement", "SR-23");
  to_permitted();
  EXPECT_EQ(step(lose_tracking).mode, Mode::hold);
  const Decision before = run(limits.hold_recovery - milliseconds(1));
  EXPECT_EQ(before.mode, Mode::hold);
  EXPECT_EQ(before.cause, Reason::tracking_lost);  // a cause although nothing is wrong any more
  EXPECT_FALSE(before.approved);
  EXPECT_EQ(step().mode, Mode::permitted);
}

TEST_F(GateTest, AnyRelapseRestartsTheRecovery) {
  RecordProperty("requirement", "SR-23");
  to_permitted();
  step(lose_tracking);
  run(limits.hold_recovery - milliseconds(1));
  EXPECT_EQ(step([](Inputs& in) { in.robot.has_status = false; }).cause, Reason::robot_silent);
  EXPECT_EQ(run(limits.hold_recovery - milliseconds(1)).mode, Mode::hold);
  EXPECT_EQ(step().mode, Mode::permitted);
}

TEST_F(GateTest, RecoveryFromACameraFaultCountsFromTheNextGoodFrame) {
  RecordProperty("requirement", "SR-05,SR-23");
  to_permitted();
  step(dark_frame);
  const Timestamp t_dark = test::good_inputs(now).camera.t_last_frame_received;
  // The dark frame stays the newest for 30 ms, without a further event.
  const auto no_frame = [&](Inputs& in) { in.camera.t_last_frame_received = t_dark; };
  EXPECT_EQ(run(milliseconds(30), no_frame).mode, Mode::hold);
  EXPECT_EQ(run(limits.hold_recovery - milliseconds(1)).mode, Mode::hold);
  EXPECT_EQ(step().mode, Mode::permitted);
}

TEST_F(GateTest, HoldBecomesAStopJustAfterItsLimit) {
  RecordProperty("requirement", "SR-22");
  to_permitted();
  step(lose_tracking);
  EXPECT_EQ(run(limits.hold_max, lose_tracking).mode, Mode::hold);  // exactly at the limit
  const Decision decision = step(lose_tracking, nanoseconds(1));
  EXPECT_EQ(decision.mode, Mode::stop_latched);
  EXPECT_EQ(decision.cause, Reason::hold_timeout);
  EXPECT_EQ(decision.stop_id, 1U);
}

TEST_F(GateTest, AFlickeringHoldTimesOutToo) {
  RecordProperty("requirement", "SR-22,SR-23");
  to_permitted();
  step(lose_tracking);
  Decision decision;
  for (int i = 0; i < 10 && decision.mode != Mode::stop_latched; ++i) {
    run(milliseconds(60));
    decision = step(lose_tracking);
    EXPECT_FALSE(decision.approved);
  }
  EXPECT_EQ(decision.cause, Reason::hold_timeout);
}

TEST_F(GateTest, RecoversAtTheLimitOfTheHoldButNotBeyond) {
  RecordProperty("requirement", "SR-22,SR-23");
  for (const milliseconds late : {milliseconds(0), milliseconds(1)}) {
    state = GateState{};
    to_permitted();
    step(lose_tracking);
    run(limits.hold_max - limits.hold_recovery + late, lose_tracking);
    run(limits.hold_recovery - milliseconds(1));
    EXPECT_EQ(step().mode, late.count() == 0 ? Mode::permitted : Mode::stop_latched);
  }
}

}  // namespace
}  // namespace holdfast::safety
