// SPDX-License-Identifier: Apache-2.0
// Which estimates the control step takes in, and what it makes of those it does not.
#include <limits>

#include <gtest/gtest.h>

#include "tests/rt/control_step_fixture.hpp"

namespace holdfast::rt {
namespace {

using safety::Mode;
using safety::Reason;
using safety::Timestamp;
using testing::ControlStep;
using testing::kPeriod;

TEST_F(ControlStep, ALostEstimateHoldsAndDoesNotCorrectTheFilter) {
  reach_permitted();
  const Timestamp newest = state.filter.t_newest();
  spoil_next_estimate(
      [](StampedEstimate& estimate) { estimate.motion.status = perception::TrackingStatus::lost; });
  EXPECT_EQ(output.decision.mode, Mode::hold);
  EXPECT_EQ(output.decision.cause, Reason::tracking_lost);
  EXPECT_EQ(state.filter.t_newest(), newest);
  EXPECT_LE(now - output.t_evidence, kPeriod);
}

TEST_F(ControlStep, ADegradedEstimateIsMarkedAndHolds) {
  reach_permitted();
  spoil_next_estimate([](StampedEstimate& estimate) {
    estimate.motion.status = perception::TrackingStatus::degraded;
  });
  EXPECT_EQ(output.decision.mode, Mode::hold);
  EXPECT_EQ(output.decision.cause, Reason::tracking_degraded);
}

TEST_F(ControlStep, AJumpStopsAndTheJumpIsNotTakenIn) {
  reach_permitted();
  const Timestamp newest = state.filter.t_newest();
  spoil_next_estimate([](StampedEstimate& estimate) {
    estimate.motion.T_camera_site.pretranslate(Eigen::Vector3d(2, 0, 0));
  });
  EXPECT_EQ(output.decision.mode, Mode::stop_latched);
  EXPECT_EQ(output.decision.cause, Reason::pose_jump);
  EXPECT_EQ(state.filter.t_newest(), newest);
  EXPECT_EQ(output.t_evidence, state.t_estimate_published);
}

TEST_F(ControlStep, ANumberThatIsNoneStops) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const auto stops_on = [&](auto spoil) {
    restart();
    reach_permitted();
    spoil_next_estimate(spoil);
    EXPECT_EQ(output.decision.mode, Mode::stop_latched);
    EXPECT_EQ(output.decision.cause, Reason::invalid_number);
    EXPECT_FALSE(output.decision.approved);
  };
  stops_on([&](StampedEstimate& e) { e.motion.T_camera_site.translation().y() = nan; });
  stops_on([&](StampedEstimate& e) { e.motion.T_camera_site.linear()(0, 0) = nan; });
  stops_on([&](StampedEstimate& e) { e.motion.covariance(2, 2) = nan; });
  stops_on([&](StampedEstimate& e) { e.motion.covariance.setZero(); });
  stops_on([&](StampedEstimate& e) { e.motion.inlier_spread = nan; });
  stops_on([&](StampedEstimate& e) { e.motion.drift_um = nan; });
}

TEST_F(ControlStep, AnEstimateOlderThanItsPredecessorIsDroppedAndReported) {
  reach_permitted();
  const Timestamp newest = state.filter.t_newest();
  spoil_next_estimate([&](StampedEstimate& estimate) {
    estimate.motion.t_exposure = newest;
    estimate.motion.inliers = 0;
  });
  EXPECT_EQ(output.decision.cause, Reason::frame_time_invalid);
  EXPECT_FALSE(state.tracking.is_new);
  EXPECT_EQ(state.tracking.inliers, 300);
}

TEST_F(ControlStep, AnEstimateFromTheFutureDoesNotPoisonTheFilter) {
  reach_permitted();
  spoil_next_estimate([&](StampedEstimate& estimate) {
    estimate.motion.t_exposure = now + std::chrono::seconds(1);
  });
  EXPECT_EQ(output.decision.cause, Reason::frame_time_invalid);
  run(std::chrono::milliseconds(300));
  EXPECT_EQ(output.decision.mode, Mode::permitted);
}

TEST_F(ControlStep, AStalledTrackerHoldsAtTheAgeLimit) {
  reach_permitted();
  inputs.has_estimates = false;
  const Timestamp limit = state.tracking.t_exposure + parameters.limits.estimate_age_max;
  while (output.decision.mode == Mode::permitted && now < limit + kPeriod) cycle();
  EXPECT_EQ(output.decision.mode, Mode::hold);
  // Either reason is right: the uncertainty has outgrown its limit, or the age has.
  if (output.decision.cause == Reason::estimate_stale) {
    EXPECT_EQ(output.t_evidence, limit);
  }
  EXPECT_LE(now, limit + kPeriod);
}

TEST_F(ControlStep, AnEstimateAgainstAnotherKeyframeIsNotTakenIn) {
  RecordProperty("requirement", "SR-35");
  reach_permitted();
  spoil_next_estimate([](StampedEstimate& estimate) {
    estimate.registration_id = 4712;
    estimate.motion.T_camera_site.translation().x() += 0.05;  // would not show as a contradiction
  });
  EXPECT_EQ(output.decision.mode, Mode::hold);
  EXPECT_EQ(output.decision.cause, Reason::tracking_lost);
  ASSERT_TRUE(output.prediction);
  const Eigen::Vector3d p_target = inputs.registration.p_target_site_mm;
  const Eigen::Vector3d truth = testing::site_at(now) * p_target;
  EXPECT_LT((output.prediction->T_camera_site * p_target - truth).norm(), 0.02);
}

}  // namespace
}  // namespace holdfast::rt
