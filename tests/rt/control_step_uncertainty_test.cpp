// SPDX-License-Identifier: Apache-2.0
// The uncertainty that the control step publishes: that of the target, as the gate judged it.
#include <cmath>

#include <gtest/gtest.h>

#include "safety/composition.hpp"
#include "tests/rt/control_step_fixture.hpp"

namespace holdfast::rt {
namespace {

using safety::Mode;
using safety::Reason;
using safety::Timestamp;
using testing::ControlStep;
using testing::kPeriod;

/// What the next cycle will publish, without changing anything.
double sigma_of_the_next_cycle(const ControlStep& step) {
  testing::VirtualInputs inputs = step.inputs;
  ControlState state = step.state;
  const Timestamp next = step.now + kPeriod;
  return control_step(next, step.parameters, inputs.at(next), state).sigma_target_mm;
}

TEST_F(ControlStep, PublishesTheUncertaintyThatTheGateJudged) {
  RecordProperty("requirement", "SR-36");
  parameters.hand_eye_sigma = {.t_mm = 0.03, .r_rad = 2e-4};
  inputs.registration.covariance *= 2;
  reach_permitted();
  ASSERT_TRUE(output.decision.approved);
  EXPECT_NEAR(output.sigma_target_mm, safety::sigma_max_mm(output.decision.approved->covariance()),
              1e-12);
  // A limit a hair below it refuses, one a hair above permits.
  const safety::Limits limits = parameters.limits;
  for (const bool is_above : {false, true}) {
    restart();
    parameters.limits = limits;
    parameters.hand_eye_sigma = {.t_mm = 0.03, .r_rad = 2e-4};
    inputs.registration.covariance *= 2;
    run(std::chrono::milliseconds(500));
    ASSERT_EQ(output.decision.mode, Mode::ready);
    parameters.limits.sigma_target_max_mm =
        sigma_of_the_next_cycle(*this) * (is_above ? 1 + 1e-6 : 1 - 1e-6);
    cycle();
    EXPECT_EQ(output.decision.reasons.contains(Reason::covariance_exceeded), !is_above);
  }
}

TEST_F(ControlStep, NoUncertaintyIsPublishedWhereNoneWasJudged) {
  RecordProperty("requirement", "SR-36");
  EXPECT_TRUE(std::isnan(cycle().sigma_target_mm));  // nothing predicted yet
  inputs.registration.is_loaded = false;
  run(std::chrono::milliseconds(500));
  ASSERT_TRUE(output.prediction);
  EXPECT_TRUE(std::isnan(output.sigma_target_mm));
}

TEST_F(ControlStep, UncertaintyAndSpeedAreAboutTheTarget) {
  inputs.registration.p_target_site_mm = Eigen::Vector3d(100, 0, 200);  // 100 mm from the pivot
  run(std::chrono::milliseconds(500));
  ASSERT_TRUE(output.prediction);
  const auto& covariance = output.prediction->covariance;
  const auto about_pivot = state.filter.predict(now, parameters.filter);
  ASSERT_TRUE(about_pivot);
  const double sigma_turn = std::sqrt(about_pivot->covariance(5, 5));
  EXPECT_NEAR(covariance(1, 1) - about_pivot->covariance(1, 1), std::pow(100 * sigma_turn, 2),
              1e-3 * covariance(1, 1));
  EXPECT_GE(output.sigma_target_mm, std::sqrt(covariance(1, 1)));
  const auto point = [&](Timestamp t) {
    return Eigen::Vector3d(testing::site_at(t) * inputs.registration.p_target_site_mm);
  };
  const Timestamp step = std::chrono::milliseconds(1);
  const double truth = (point(now + step) - point(now)).norm() / 1e-3;
  EXPECT_NEAR(output.prediction->speed_mm_per_s, truth, 0.05 * truth);
}

TEST_F(ControlStep, UncertaintyGrowsWithTheTimeSinceTheNewestEstimate) {
  RecordProperty("requirement", "SR-66");
  run(std::chrono::milliseconds(500));
  inputs.has_estimates = false;
  double previous = output.sigma_target_mm;
  for (int i = 0; i < 50; ++i) {
    EXPECT_GT(cycle().sigma_target_mm, previous);
    previous = output.sigma_target_mm;
  }
}

}  // namespace
}  // namespace holdfast::rt
