// SPDX-License-Identifier: Apache-2.0
// The gate without faults: permission and what it takes.
#include "safety/gate.hpp"

#include <type_traits>
#include <utility>

#include <gtest/gtest.h>

#include "tests/safety/gate_fixture.hpp"

namespace holdfast::safety {
namespace {

using std::chrono::milliseconds;
using test::dark_frame;
using test::GateTest;
using test::lose_tracking;

static_assert(!std::is_default_constructible_v<ApprovedPose>);
static_assert(!std::is_aggregate_v<ApprovedPose>);
static_assert(noexcept(Gate::decide(std::declval<const Limits&>(), std::declval<const Inputs&>(),
                                    std::declval<GateState&>())));

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

TEST_F(GateTest, APoseIsForTheInstantOfItsUse) {
  RecordProperty("requirement", "SR-124");
  limits.pose_lead = milliseconds(4);
  const Decision decision = to_permitted();
  ASSERT_TRUE(decision.approved);
  EXPECT_EQ(decision.approved->t_pose(), now + milliseconds(4));
  EXPECT_EQ(decision.approved->validity(), limits.pose_validity);
}

TEST_F(GateTest, RemembersWhenItsModeBegan) {
  to_permitted();
  const Timestamp t_permitted = now;
  EXPECT_EQ(state.t_mode_entered, t_permitted);
  run(milliseconds(5));
  EXPECT_EQ(state.t_mode_entered, t_permitted);
  command(Command::stop);
  EXPECT_EQ(state.t_mode_entered, now);
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

}  // namespace
}  // namespace holdfast::safety
