// SPDX-License-Identifier: Apache-2.0
// Broken invariants: what the gate makes of a state or a decision that must not be.
#include <gtest/gtest.h>

#include "safety/gate.hpp"
#include "tests/safety/gate_fixture.hpp"

namespace holdfast::safety {
namespace {

using std::chrono::nanoseconds;
using test::GateTest;

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
