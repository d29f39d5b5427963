// SPDX-License-Identifier: Apache-2.0
#include "safety/gate.hpp"

#include <type_traits>

#include <gtest/gtest.h>

#include "tests/safety/good_inputs.hpp"

namespace holdfast::safety {
namespace {

using test::GateDriver;
using test::good_inputs;

class GateTest : public ::testing::Test, public GateDriver {};

static_assert(!std::is_default_constructible_v<ApprovedPose>);
static_assert(!std::is_aggregate_v<ApprovedPose>);

TEST_F(GateTest, StartsInInitAndRefuses) {
  RecordProperty("requirement", "SR-01,SR-02");
  const Decision decision = step([](Inputs& inputs) {
    const Timestamp time = inputs.now;
    inputs = Inputs{};
    inputs.now = time;
  });
  EXPECT_EQ(decision.mode, Mode::init);
  EXPECT_FALSE(decision.approved);
  EXPECT_TRUE(decision.reasons.contains(Reason::initialising));
}

TEST_F(GateTest, IsNotPermittedByGoodInputsAlone) {
  RecordProperty("requirement", "SR-26");
  const Decision decision = run(std::chrono::seconds(2));
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

}  // namespace
}  // namespace holdfast::safety
