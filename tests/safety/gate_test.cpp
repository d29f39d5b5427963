// SPDX-License-Identifier: Apache-2.0
// The gate over time: each fault in each mode, holds, stops and their end.
#include "safety/gate.hpp"

#include <type_traits>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "safety/mode_table.hpp"
#include "tests/safety/faults.hpp"

namespace holdfast::safety {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using test::GateDriver;

static_assert(!std::is_default_constructible_v<ApprovedPose>);
static_assert(!std::is_aggregate_v<ApprovedPose>);
static_assert(noexcept(Gate::decide(std::declval<const Limits&>(), std::declval<const Inputs&>(),
                                    std::declval<GateState&>())));

void dark_frame(Inputs& inputs) {
  inputs.camera.faults.insert(Reason::frame_dark);
}
void lose_tracking(Inputs& inputs) {
  inputs.tracking.is_lost = true;
}
void drift(Inputs& inputs) {
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

// --- Permission ---------------------------------------------------------------------------------

TEST_F(GateTest, StartsInInitAndRefuses) {
  RecordProperty("requirement", "SR-01,SR-02,SR-34");
  const Decision decision = step([](Inputs& inputs) {
    const Timestamp time = inputs.now;
    inputs = Inputs{};
    inputs.now = time;
  });
  EXPECT_EQ(decision.mode, Mode::init);
  EXPECT_NE(decision.cause, Reason::none);
  EXPECT_FALSE(decision.approved);
  EXPECT_TRUE(decision.reasons.contains(Reason::initialising));
  EXPECT_TRUE(decision.reasons.contains(Reason::not_registered));
}

TEST_F(GateTest, IsNotPermittedByGoodInputsAlone) {
  RecordProperty("requirement", "SR-26");
  const Decision decision = run(milliseconds(2000));
  EXPECT_EQ(decision.mode, Mode::ready);
  EXPECT_EQ(decision.cause, Reason::not_armed);
  EXPECT_FALSE(decision.approved);
}

TEST_F(GateTest, PermitsOnceArmed) {
  RecordProperty("requirement", "SR-01");
  const Decision decision = to_permitted();
  EXPECT_EQ(decision.mode, Mode::permitted);
  EXPECT_EQ(decision.cause, Reason::none);
  EXPECT_TRUE(decision.reasons.empty());
  ASSERT_TRUE(decision.approved);
  EXPECT_EQ(decision.approved->t_pose(), now);
  EXPECT_EQ(decision.approved->validity(), limits.pose_validity);
  EXPECT_EQ(decision.approved->registration_id(), test::kRegistrationId);
}

TEST_F(GateTest, DisarmingEndsPermission) {
  to_permitted();
  const Decision decision = command(Command::disarm);
  EXPECT_EQ(decision.mode, Mode::ready);
  EXPECT_FALSE(decision.approved);
}

TEST_F(GateTest, DisarmingEndsAHold) {
  to(Mode::hold);
  EXPECT_EQ(command(Command::disarm).mode, Mode::ready);
}

TEST_F(GateTest, ArmingIsIgnoredBeforeReady) {
  RecordProperty("requirement", "SR-26");
  const Decision decision = step([](Inputs& in) {
    in.operator_command.command = Command::arm;
    in.registration.is_loaded = false;
  });
  EXPECT_EQ(decision.mode, Mode::unregistered);
  run(milliseconds(50));
  EXPECT_EQ(state.mode, Mode::ready);  // it was not remembered either
}

TEST_F(GateTest, ArmingWaitsForAGoodFrameAfterACameraFault) {
  RecordProperty("requirement", "SR-05,SR-26");
  to_ready();
  step(dark_frame);
  const Timestamp t_old_frame = state.t_frame_at_fault;
  const auto arm_without_frame = [&](Inputs& in) {
    in.operator_command.command = Command::arm;
    in.camera.t_last_frame_received = t_old_frame;
  };
  EXPECT_EQ(step(arm_without_frame).mode, Mode::ready);
  EXPECT_EQ(command(Command::arm).mode, Mode::permitted);
}

TEST_F(GateTest, SaysWhenModeOrCauseChanged) {
  EXPECT_TRUE(step().changed);  // the first
  to_ready();
  EXPECT_FALSE(step().changed);
  EXPECT_TRUE(step(lose_tracking).changed);  // same mode, other cause
  EXPECT_FALSE(step(lose_tracking).changed);
  EXPECT_TRUE(step().changed);
  EXPECT_TRUE(command(Command::arm).changed);
  EXPECT_FALSE(step().changed);
}

// --- Every fault in every mode ------------------------------------------------------------------

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
  for (const Mode mode : {Mode::unregistered, Mode::ready}) {
    state = GateState{};
    to(mode);
    const Decision decision = step([&](Inputs& inputs) {
      GetParam().inject(inputs, limits);
      inputs.tracking.is_new = false;
    });
    EXPECT_EQ(decision.mode, latches ? Mode::stop_latched : mode) << name(mode);
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

// --- Registration -------------------------------------------------------------------------------

TEST_F(GateTest, IsNotReadyWithoutARegistration) {
  RecordProperty("requirement", "SR-15");
  const Decision decision =
      run(milliseconds(500), [](Inputs& in) { in.registration.is_loaded = false; });
  EXPECT_EQ(decision.mode, Mode::unregistered);
  EXPECT_EQ(decision.cause, Reason::not_registered);
}

TEST_F(GateTest, IsNotReadyBeforeTheDriftCheckPasses) {
  RecordProperty("requirement", "SR-15");
  const std::vector<GateDriver::Change> failing = {
      lose_tracking,
      drift,
      dark_frame,
      [](Inputs& in) { in.tracking.is_degraded = true; },
      [](Inputs& in) { in.tracking.inliers = 5; },
      [](Inputs& in) { in.tracking.is_new = false; },
      [](Inputs& in) { in.tracking.has_drift = false; },
      [](Inputs& in) { in.prediction.reset(); },
      [](Inputs& in) { in.prediction->T_camera_site.translation().x() = 20; }};
  for (std::size_t i = 0; i < failing.size(); ++i) {
    state = GateState{};
    const Decision decision = run(milliseconds(100), failing[i]);
    EXPECT_EQ(decision.mode, Mode::unregistered) << i;
    EXPECT_TRUE(decision.reasons.contains(Reason::keyframe_unverified)) << i;
  }
}

TEST_F(GateTest, BecomesReadyWithoutTheRobot) {
  const Decision decision = run(milliseconds(100), [](Inputs& in) { in.robot = RobotInput{}; });
  EXPECT_EQ(decision.mode, Mode::ready);
  EXPECT_EQ(decision.cause, Reason::robot_silent);
}

TEST_F(GateTest, VerifiesOnlyWithAnImageExposedAfterTheRegistrationCame) {
  RecordProperty("requirement", "SR-32");
  step();
  const Timestamp t_seen = now;
  const auto exposed_at = [](Timestamp t) {
    return [t](Inputs& in) { in.tracking.t_exposure = t; };
  };
  EXPECT_EQ(step(exposed_at(t_seen)).mode, Mode::unregistered);
  EXPECT_EQ(step(exposed_at(t_seen + nanoseconds(1))).mode, Mode::ready);
}

TEST_F(GateTest, AnotherRegistrationWithdrawsTheVerification) {
  RecordProperty("requirement", "SR-15,SR-32");
  to_ready();
  const auto other = [](Inputs& in) { in.registration.id = in.tracking.registration_id = 5; };
  const Decision decision = step(other);
  EXPECT_EQ(decision.mode, Mode::unregistered);
  EXPECT_TRUE(decision.reasons.contains(Reason::registration_changed));
  EXPECT_TRUE(decision.reasons.contains(Reason::keyframe_unverified));
  EXPECT_FALSE(step(other).reasons.contains(Reason::registration_changed));
  EXPECT_EQ(run(milliseconds(20), other).mode, Mode::ready);
}

TEST_F(GateTest, AnEstimateAgainstAnotherKeyframeVerifiesNothing) {
  RecordProperty("requirement", "SR-35");
  const auto other = [](Inputs& in) { in.tracking.registration_id = 5; };
  const Decision decision = run(milliseconds(50), other);
  EXPECT_EQ(decision.mode, Mode::unregistered);
  EXPECT_TRUE(decision.reasons.contains(Reason::tracking_lost));
  EXPECT_EQ(step().mode, Mode::ready);
}

TEST_F(GateTest, ARegistrationThatChangesOrGoesInUseStops) {
  RecordProperty("requirement", "SR-15");
  const std::vector<GateDriver::Change> changes = {
      [](Inputs& in) { in.registration.id = 5; },
      [](Inputs& in) { in.registration.is_loaded = false; }};
  for (const Mode mode : {Mode::permitted, Mode::hold}) {
    for (const auto& change : changes) {
      state = GateState{};
      to(mode);
      const Decision decision = step(change);
      EXPECT_EQ(decision.mode, Mode::stop_latched) << name(mode);
      EXPECT_EQ(decision.cause, Reason::registration_changed) << name(mode);
    }
  }
}

// --- Hold ---------------------------------------------------------------------------------------

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
  const Timestamp t_dark = state.t_frame_at_fault;
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

// --- The end of a latched stop ------------------------------------------------------------------

class LatchedStop : public GateTest {
 protected:
  void SetUp() override {
    RecordProperty("requirement", "SR-24,SR-25");
    to(Mode::stop_latched);
  }
  /// Acknowledges now and confirms `after` later, the inputs of that cycle changed by `change`.
  Mode acknowledge_and_confirm(Duration after, const Change& change = {}) {
    command(Command::acknowledge, state.stop_id);
    run(after - milliseconds(1));
    const std::uint32_t stop_id = state.stop_id;
    return step([&](Inputs& in) {
             in.operator_command = {Command::confirm, stop_id};
             if (change) change(in);
           })
        .mode;
  }
};

TEST_F(LatchedStop, StaysThoughAllIsWell) {
  const Decision decision = run(milliseconds(20'000));
  EXPECT_EQ(decision.mode, Mode::stop_latched);
  EXPECT_EQ(decision.cause, Reason::operator_stop);
  EXPECT_TRUE(decision.reasons.contains(Reason::awaiting_acknowledgement));
}

TEST_F(LatchedStop, EndsInReadyByBothStepsAndNeedsArmingAgain) {
  EXPECT_EQ(acknowledge_and_confirm(limits.confirm_min), Mode::ready);
  EXPECT_EQ(run(milliseconds(1000)).mode, Mode::ready);
  EXPECT_EQ(command(Command::arm).mode, Mode::permitted);
}

TEST_F(LatchedStop, AcceptsConfirmationAtBothEndsOfItsWindow) {
  EXPECT_EQ(acknowledge_and_confirm(limits.confirm_min), Mode::ready);
  command(Command::stop);
  EXPECT_EQ(acknowledge_and_confirm(limits.confirm_max), Mode::ready);
}

TEST_F(LatchedStop, RefusesConfirmationTooEarlyOrTooLate) {
  EXPECT_EQ(acknowledge_and_confirm(limits.confirm_min - milliseconds(1)), Mode::stop_latched);
  run(limits.confirm_min);  // now in the window of an acknowledgement that no longer counts
  EXPECT_EQ(command(Command::confirm, 1).mode, Mode::stop_latched);
  EXPECT_EQ(acknowledge_and_confirm(limits.confirm_max + milliseconds(1)), Mode::stop_latched);
}

TEST_F(LatchedStop, RefusesAConfirmationWithoutAcknowledgement) {
  run(limits.confirm_min);
  EXPECT_EQ(command(Command::confirm, 1).mode, Mode::stop_latched);
}

TEST_F(LatchedStop, RefusesAWrongStopIdInEitherStep) {
  command(Command::acknowledge, 2);
  run(limits.confirm_min);
  EXPECT_EQ(command(Command::confirm, 1).mode, Mode::stop_latched);

  command(Command::acknowledge, 1);
  run(limits.confirm_min);
  EXPECT_EQ(command(Command::confirm, 0).mode, Mode::stop_latched);
  EXPECT_EQ(command(Command::confirm, 1).mode, Mode::stop_latched);  // restarted by the wrong one
}

TEST_F(LatchedStop, AWrongAcknowledgementRevokesARightOne) {
  command(Command::acknowledge, 1);
  command(Command::acknowledge, 2);
  run(limits.confirm_min);
  EXPECT_EQ(command(Command::confirm, 1).mode, Mode::stop_latched);
}

TEST_F(LatchedStop, RefusesTheIdOfAnEarlierStop) {
  ASSERT_EQ(acknowledge_and_confirm(limits.confirm_min), Mode::ready);
  command(Command::stop);
  ASSERT_EQ(state.stop_id, 2U);
  command(Command::acknowledge, 1);
  run(limits.confirm_min);
  EXPECT_EQ(command(Command::confirm, 1).mode, Mode::stop_latched);
}

TEST_F(LatchedStop, AStopReasonInBetweenRestarts) {
  command(Command::acknowledge, 1);
  step(drift);
  run(limits.confirm_min);
  EXPECT_EQ(command(Command::confirm, 1).mode, Mode::stop_latched);
}

TEST_F(LatchedStop, CannotBeAcknowledgedWhileAStopReasonLasts) {
  step([](Inputs& in) {
    in.operator_command = {Command::acknowledge, 1};
    drift(in);
  });
  run(limits.confirm_min);
  EXPECT_EQ(command(Command::confirm, 1).mode, Mode::stop_latched);
}

TEST_F(LatchedStop, NeedsAnImageExposedAfterTheAcknowledgement) {
  const Timestamp t_acknowledged = now + milliseconds(1);
  limits.estimate_age_max = std::chrono::seconds(1);
  const auto exposed_at = [](Timestamp t) {
    return [t](Inputs& in) { in.tracking.t_exposure = t; };
  };
  EXPECT_EQ(acknowledge_and_confirm(limits.confirm_min, exposed_at(t_acknowledged)),
            Mode::stop_latched);
  const Timestamp t_next = now + milliseconds(1);
  EXPECT_EQ(acknowledge_and_confirm(limits.confirm_min, exposed_at(t_next + nanoseconds(1))),
            Mode::ready);
}

TEST_F(LatchedStop, NeedsAGoodFrameAfterACameraFault) {
  command(Command::acknowledge, 1);
  run(limits.confirm_min);
  step(dark_frame);
  const Timestamp t_dark = state.t_frame_at_fault;
  const Decision decision = step([&](Inputs& in) {
    in.operator_command = {Command::confirm, 1};
    in.camera.t_last_frame_received = t_dark;
  });
  EXPECT_EQ(decision.mode, Mode::stop_latched);
}

TEST_F(LatchedStop, NeedsARegistration) {
  const auto withdrawn = [](Inputs& in) { in.registration.is_loaded = false; };
  step(withdrawn);
  command(Command::acknowledge, 1);
  run(limits.confirm_min, withdrawn);
  const Decision decision = step([&](Inputs& in) {
    in.operator_command = {Command::confirm, 1};
    withdrawn(in);
  });
  EXPECT_EQ(decision.mode, Mode::stop_latched);
}

TEST_F(LatchedStop, ItsEndVerifiesTheRegistrationThatIsLoadedThen) {
  RecordProperty("requirement", "SR-24,SR-32");
  const auto other = [](Command command, std::uint32_t stop_id) {
    return [=](Inputs& in) {
      in.registration.id = in.tracking.registration_id = 5;
      in.operator_command = {command, stop_id};
    };
  };
  step(other(Command::none, 0));
  EXPECT_FALSE(state.is_keyframe_verified);
  step(other(Command::acknowledge, 1));
  run(limits.confirm_min, other(Command::none, 0));
  EXPECT_FALSE(state.is_keyframe_verified);
  EXPECT_EQ(step(other(Command::confirm, 1)).mode, Mode::ready);
  EXPECT_TRUE(state.is_keyframe_verified);
  EXPECT_EQ(state.registration_id, 5U);
}

TEST_F(LatchedStop, IgnoresOtherCommands) {
  for (const Command other : {Command::arm, Command::disarm, Command::none}) {
    EXPECT_EQ(command(other, 1).mode, Mode::stop_latched);
  }
}

// --- Broken invariants --------------------------------------------------------------------------

class BrokenState : public GateTest {
 protected:
  void SetUp() override { RecordProperty("requirement", "SR-28"); }
  void expect_internal_fault(const Decision& decision) {
    EXPECT_EQ(decision.mode, Mode::stop_latched);
    EXPECT_EQ(decision.cause, Reason::internal_fault);
    EXPECT_TRUE(decision.reasons.contains(Reason::internal_fault));
    EXPECT_FALSE(decision.approved);
    EXPECT_NE(decision.stop_id, 0U);
    EXPECT_EQ(state.mode, Mode::stop_latched);
    EXPECT_EQ(state.stop_cause, Reason::internal_fault);
  }
};

TEST_F(BrokenState, PermittedWithoutVerification) {
  to_permitted();
  state.is_keyframe_verified = false;
  expect_internal_fault(step());
}

TEST_F(BrokenState, PermittedFromNothing) {
  state.mode = Mode::permitted;
  expect_internal_fault(step());
}

TEST_F(BrokenState, ModeThatDoesNotExist) {
  to_permitted();
  state.mode = static_cast<Mode>(77);
  expect_internal_fault(step());
}

TEST_F(BrokenState, StopWithoutCauseOrId) {
  state.mode = Mode::stop_latched;
  expect_internal_fault(step());
  state.stop_cause = Reason::frame_dark;
  expect_internal_fault(step());
}

TEST_F(BrokenState, UnregisteredThoughVerified) {
  to_ready();
  state.mode = Mode::unregistered;
  expect_internal_fault(step([](Inputs& in) { in.tracking.is_new = false; }));
}

TEST_F(BrokenState, PoseThatOverflows) {
  to_permitted();
  limits.displacement_max_mm = 1e300;
  limits.sigma_target_max_mm = 1e300;
  expect_internal_fault(step([](Inputs& in) {
    in.T_robot_camera.translation().setConstant(1.5e308);
    in.registration.T_site_ct.translation().setConstant(1.5e308);
    in.registration.p_target_site_mm.setConstant(1.5e308);
  }));
}

TEST_F(BrokenState, PoseWithoutValidity) {
  limits.pose_validity = nanoseconds(0);
  expect_internal_fault(to_permitted());
}

TEST_F(BrokenState, StopIdNeverBecomesTheOneThatNamesNoStop) {
  state.stop_id = 0xFFFF'FFFF;
  EXPECT_EQ(command(Command::stop).stop_id, 1U);
}

}  // namespace
}  // namespace holdfast::safety
