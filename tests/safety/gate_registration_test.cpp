// SPDX-License-Identifier: Apache-2.0
// The gate and the registration: what it takes to trust one, and to lose that trust.
#include <vector>

#include <gtest/gtest.h>

#include "safety/gate.hpp"
#include "tests/safety/gate_fixture.hpp"

namespace holdfast::safety {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using test::dark_frame;
using test::drift;
using test::GateDriver;
using test::GateTest;
using test::lose_tracking;

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

/// What the robot says of itself tells nothing of the image.
TEST_F(GateTest, TheKeyframeIsVerifiedWhileTheRobotIsFaulty) {
  run(milliseconds(100), [](Inputs& in) { in.robot.has_fault = true; });
  EXPECT_TRUE(state.is_keyframe_verified);
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

TEST_F(GateTest, AReleaseVerifiesOnlyWithAnImageExposedAfterTheRegistrationCame) {
  RecordProperty("requirement", "SR-32");
  const auto without = [](Inputs& in) { in.registration.is_loaded = false; };
  run(milliseconds(20), without);
  command(Command::stop);
  const auto confirmed_with_an_image_of = [&](Duration before) {
    return step([&](Inputs& in) {
      in.tracking.t_exposure = in.now - before;
      in.operator_command = {Command::confirm, state.stop_id};
    });
  };
  const auto acknowledge_without = [&] {
    step([&](Inputs& in) {
      without(in);
      in.operator_command = {Command::acknowledge, state.stop_id};
    });
    run(milliseconds(300), without);
  };
  acknowledge_without();
  EXPECT_EQ(confirmed_with_an_image_of(nanoseconds(0)).mode, Mode::stop_latched);
  acknowledge_without();
  step();
  EXPECT_EQ(confirmed_with_an_image_of(milliseconds(1)).mode, Mode::stop_latched);
  acknowledge_without();
  run(milliseconds(20));
  EXPECT_EQ(confirmed_with_an_image_of(milliseconds(10)).mode, Mode::ready);
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

}  // namespace
}  // namespace holdfast::safety
