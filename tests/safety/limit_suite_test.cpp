// SPDX-License-Identifier: Apache-2.0
// The suite that every limit shares: accepts at the limit, refuses just beyond, refuses NaN.
#include <limits>

#include <gtest/gtest.h>

#include "safety/monitors.hpp"
#include "tests/safety/faults.hpp"

namespace holdfast::safety {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr Timestamp kNow = std::chrono::seconds(100);

const auto kCaseName = [](const auto& info) { return info.param.name; };

TEST(GoodInputs, GiveNoReason) {
  EXPECT_TRUE(observed_reasons({}, test::good_inputs(kNow), {}).empty());
}

class LimitSuite : public ::testing::TestWithParam<test::LimitCase> {
 protected:
  void SetUp() override { RecordProperty("requirement", GetParam().requirement); }
  Limits limits;
  Inputs inputs = test::good_inputs(kNow);
};
INSTANTIATE_TEST_SUITE_P(Every, LimitSuite, ::testing::ValuesIn(test::limit_cases()), kCaseName);

TEST_P(LimitSuite, AcceptsAtTheLimit) {
  GetParam().at(inputs, limits);
  EXPECT_EQ(observed_reasons(limits, inputs, {}).bits(), 0U);
}

TEST_P(LimitSuite, RefusesJustBeyond) {
  GetParam().beyond(inputs, limits);
  ReasonSet expected;
  expected.insert(GetParam().reason);
  EXPECT_EQ(observed_reasons(limits, inputs, {}).bits(), expected.bits());
}

class RealLimitSuite : public ::testing::TestWithParam<test::RealLimitCase> {
 protected:
  void SetUp() override { RecordProperty("requirement", "SR-03"); }
  Limits limits;
  Inputs inputs = test::good_inputs(kNow);
};
INSTANTIATE_TEST_SUITE_P(Every, RealLimitSuite, ::testing::ValuesIn(test::real_limit_cases()),
                         kCaseName);

TEST_P(RealLimitSuite, RefusesNan) {
  GetParam().set(inputs, kNan);
  const ReasonSet reasons = observed_reasons(limits, inputs, {});
  EXPECT_TRUE(reasons.contains(GetParam().reason));
  EXPECT_TRUE(reasons.contains(Reason::invalid_number));
}

TEST_P(RealLimitSuite, RefusesWhenTheLimitItselfIsNan) {
  limits.*GetParam().limit = kNan;
  EXPECT_TRUE(observed_reasons(limits, inputs, {}).contains(GetParam().reason));
}

class FaultSuite : public ::testing::TestWithParam<test::Fault> {
 protected:
  void SetUp() override { RecordProperty("requirement", GetParam().requirement); }
};
INSTANTIATE_TEST_SUITE_P(Every, FaultSuite, ::testing::ValuesIn(test::faults()), kCaseName);

TEST_P(FaultSuite, IsSeenAndIsThePrimaryReason) {
  Inputs inputs = test::good_inputs(kNow);
  GetParam().inject(inputs, {});
  EXPECT_EQ(name(observed_reasons({}, inputs, {}).primary()), name(GetParam().reason));
}

// What the monitors deliberately do not judge.

TEST(Monitors, ReadNothingOfAnUnloadedRegistration) {
  Inputs inputs = test::good_inputs(kNow);
  inputs.registration = RegistrationInput{};
  inputs.registration.T_site_ct(0, 0) = kNan;
  EXPECT_EQ(observed_reasons({}, inputs, {}).bits(), 0U);
}

TEST(Monitors, DoNotJudgeMotionExtrapolatedFromAStaleEstimate) {
  RecordProperty("requirement", "SR-07");
  Inputs inputs = test::good_inputs(kNow);
  inputs.tracking.t_exposure = kNow - std::chrono::seconds(1);
  inputs.prediction->T_camera_site.translation().x() = 1000;
  ReasonSet expected;
  expected.insert(Reason::estimate_stale);
  EXPECT_EQ(observed_reasons({}, inputs, {}).bits(), expected.bits());
}

TEST(Monitors, SeeTimeGoingBackwards) {
  RecordProperty("requirement", "SR-13");
  GateState state;
  state.has_cycle = true;
  state.t_last_cycle = kNow;
  EXPECT_EQ(observed_reasons({}, test::good_inputs(kNow), state).bits(), 0U);
  const Inputs earlier = test::good_inputs(kNow - std::chrono::nanoseconds(1));
  EXPECT_EQ(observed_reasons({}, earlier, state).primary(), Reason::clock_step);
}

TEST(Monitors, SeeARegistrationChangeOnlyOfAVerifiedOne) {
  RecordProperty("requirement", "SR-15");
  Inputs inputs = test::good_inputs(kNow);
  GateState state;
  state.registration_id = inputs.registration.id + 1;
  EXPECT_EQ(observed_reasons({}, inputs, state).bits(), 0U);
  state.is_keyframe_verified = true;
  EXPECT_EQ(observed_reasons({}, inputs, state).primary(), Reason::registration_changed);
  state.registration_id = inputs.registration.id;
  EXPECT_EQ(observed_reasons({}, inputs, state).bits(), 0U);
  inputs.registration.is_loaded = false;
  EXPECT_EQ(observed_reasons({}, inputs, state).primary(), Reason::registration_changed);
}

TEST(Monitors, ExpectTheScaleOfTheZoomThatWasRead) {
  RecordProperty("requirement", "SR-99");
  Limits limits;
  limits.zoom_tolerance = 0.1;
  limits.scale_mismatch_max = 0.01;
  Inputs inputs = test::good_inputs(kNow);
  inputs.optics.zoom = 1.05 * inputs.registration.zoom;
  inputs.tracking.scale = 1.05;
  EXPECT_EQ(observed_reasons(limits, inputs, {}).bits(), 0U);
  inputs.tracking.scale = 1;
  EXPECT_EQ(observed_reasons(limits, inputs, {}).primary(), Reason::scale_mismatch);
  inputs.tracking.scale = 1.05 * 1.0099;  // the limit is a share of what is expected
  EXPECT_EQ(observed_reasons(limits, inputs, {}).bits(), 0U);
}

TEST(Monitors, TakeInliersAllOverTheImageForWhatTheyAre) {
  Inputs inputs = test::good_inputs(kNow);
  inputs.tracking.inlier_spread = 1;
  EXPECT_EQ(observed_reasons({}, inputs, {}).bits(), 0U);
}

/// A camera that reports a stop is believed, and the stop keeps its name.
TEST(Monitors, KeepTheNameOfAStopThatTheCameraReports) {
  Inputs inputs = test::good_inputs(kNow);
  inputs.camera.faults.insert(Reason::clock_step);
  ReasonSet expected;
  expected.insert(Reason::clock_step);
  EXPECT_EQ(observed_reasons({}, inputs, {}).bits(), expected.bits());
}

}  // namespace
}  // namespace holdfast::safety
