// SPDX-License-Identifier: Apache-2.0
// The end of a latched stop.
#include <limits>

#include <gtest/gtest.h>

#include "safety/gate.hpp"
#include "tests/safety/gate_fixture.hpp"

namespace holdfast::safety {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using test::dark_frame;
using test::drift;
using test::GateTest;

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

/// However recently the stop before it was acknowledged.
TEST_F(LatchedStop, AnAcknowledgementIsOfOneStopOnly) {
  ASSERT_EQ(acknowledge_and_confirm(limits.confirm_min), Mode::ready);
  ASSERT_EQ(command(Command::stop).stop_id, 2U);
  EXPECT_EQ(command(Command::confirm, 2).mode, Mode::stop_latched);
  state = GateState{};
  to_ready();
  state.is_acknowledged = true;  // as nothing should leave it
  state.t_acknowledged = now;
  ASSERT_EQ(command(Command::stop).stop_id, 1U);
  run(limits.confirm_min);
  EXPECT_EQ(command(Command::confirm, 1).mode, Mode::stop_latched);
}

TEST_F(LatchedStop, ItsNumberIsNeverZero) {
  state = GateState{};
  to_ready();
  state.stop_id = std::numeric_limits<std::uint32_t>::max() - 1;
  EXPECT_EQ(command(Command::stop).stop_id, std::numeric_limits<std::uint32_t>::max());
  ASSERT_EQ(acknowledge_and_confirm(limits.confirm_min), Mode::ready);
  const Decision wrapped = command(Command::stop);
  EXPECT_EQ(wrapped.stop_id, 1U);
  EXPECT_EQ(wrapped.cause, Reason::operator_stop);  // not by the gate's last look at itself
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

}  // namespace
}  // namespace holdfast::safety
