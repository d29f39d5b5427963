// SPDX-License-Identifier: Apache-2.0
#include "rt/control_step.hpp"

#include <cmath>
#include <cstring>
#include <limits>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "rt/core/mailbox.hpp"
#include "safety/composition.hpp"
#include "tests/rt/virtual_inputs.hpp"

namespace holdfast::rt {
namespace {

using safety::Mode;
using safety::Reason;
using safety::Timestamp;
using testing::kFramePeriod;
using testing::kStart;

static_assert(OwnsNothing<ControlOutput>);
static_assert(OwnsNothing<StampedEstimate>);
static_assert(OwnsNothing<FrameArrival>);

constexpr safety::Duration kPeriod = std::chrono::milliseconds(1);

class ControlStep : public ::testing::Test {
 public:
  /// One cycle at 1 kHz; `spoil` may change the readings first.
  template <typename Spoil>
  ControlOutput cycle(Spoil spoil) {
    now += kPeriod;
    Readings readings = inputs.at(now);
    spoil(readings);
    output = control_step(now, parameters, readings, state);
    return output;
  }
  ControlOutput cycle() {
    return cycle([](Readings&) {});
  }
  void run(safety::Duration time) {
    for (const Timestamp end = now + time; now < end;) cycle();
  }
  /// Goes on until the cycle in which the next estimate arrives, and spoils that one.
  template <typename Spoil>
  ControlOutput spoil_next_estimate(Spoil spoil) {
    for (bool is_done = false; !is_done;) {
      cycle([&](Readings& readings) {
        if (!readings.estimate) return;
        spoil(*readings.estimate);
        is_done = true;
      });
    }
    return output;
  }
  void restart() {
    parameters = testing::healthy_parameters();
    inputs = {};
    state = {};
    now = kStart;
    output = {};
  }
  /// What the next cycle will publish, without changing anything.
  double sigma_of_the_next_cycle() const {
    testing::VirtualInputs next_inputs = inputs;
    ControlState next_state = state;
    const Readings readings = next_inputs.at(now + kPeriod);
    return control_step(now + kPeriod, parameters, readings, next_state).sigma_target_mm;
  }
  void reach_permitted() {
    run(std::chrono::milliseconds(500));
    ASSERT_EQ(output.decision.mode, Mode::ready);
    cycle([](Readings& readings) { readings.operator_command.command = safety::Command::arm; });
    ASSERT_EQ(output.decision.mode, Mode::permitted);
  }

  ControlParameters parameters = testing::healthy_parameters();
  testing::VirtualInputs inputs;
  ControlState state;
  Timestamp now = kStart;
  ControlOutput output;
};

TEST_F(ControlStep, ApprovesThePredictedPoseWhileAllIsWell) {
  reach_permitted();
  for (int i = 0; i < 500; ++i) {
    cycle();
    ASSERT_EQ(output.decision.mode, Mode::permitted) << safety::name(output.decision.cause);
    ASSERT_TRUE(output.decision.approved);
    const Eigen::Vector3d p_target = inputs.registration.p_target_site_mm;
    const Eigen::Vector3d truth = testing::site_at(now) * p_target;
    const Eigen::Vector3d approved = output.decision.approved->T_robot_ct().translation();
    EXPECT_LT((approved - truth).norm(), 3 * output.sigma_target_mm);
    EXPECT_LT((approved - truth).norm(), 0.02);
  }
}

TEST_F(ControlStep, WithdrawsInTheFirstCycleAfterTheFrameDeadline) {
  RecordProperty("requirement", "SR-74");
  reach_permitted();
  inputs.has_frames = false;
  const Timestamp deadline = state.camera.t_last_frame_received + parameters.limits.frame_period +
                             parameters.limits.frame_lateness;
  while (now + kPeriod <= deadline) ASSERT_EQ(cycle().decision.mode, Mode::permitted);
  cycle();
  EXPECT_EQ(output.decision.mode, Mode::hold);
  EXPECT_EQ(output.decision.cause, Reason::frame_late);
  EXPECT_EQ(output.t_evidence, deadline);
  EXPECT_LE(now - output.t_evidence, kPeriod);
}

TEST_F(ControlStep, KeepsTheEvidenceUntilModeOrCauseChange) {
  reach_permitted();
  inputs.has_frames = false;
  run(std::chrono::milliseconds(45));
  ASSERT_EQ(output.decision.cause, Reason::frame_late);
  const Timestamp evidence = output.t_evidence;
  run(std::chrono::milliseconds(10));
  EXPECT_EQ(output.t_evidence, evidence);
}

TEST_F(ControlStep, NoFaultIsLostAmongSeveralArrivalsOfOneCycle) {
  RecordProperty("requirement", "SR-74");
  for (const Reason fault : {Reason::frame_gap, Reason::frame_incomplete, Reason::frame_frozen,
                             Reason::frame_dark, Reason::frame_saturated}) {
    SCOPED_TRACE(safety::name(fault));
    restart();
    reach_permitted();
    cycle([&](Readings& readings) {
      readings.arrival_count = 3;
      for (std::size_t i = 0; i < 3; ++i) {
        readings.arrivals[i] = FrameArrival{};
        readings.arrivals[i].t_received =
            now - std::chrono::microseconds(300 - 100 * static_cast<int>(i));
      }
      readings.arrivals[0].faults.insert(fault);
    });
    EXPECT_EQ(output.decision.mode, Mode::hold);
    EXPECT_EQ(output.decision.cause, fault);
    EXPECT_EQ(output.t_evidence, now - std::chrono::microseconds(300));
  }
}

TEST_F(ControlStep, AnIncompleteFrameDoesNotFeedTheFrameDeadline) {
  reach_permitted();
  const Timestamp newest = state.camera.t_last_frame_received;
  cycle([&](Readings& readings) {
    readings.arrival_count = 1;
    readings.arrivals[0].t_received = now;
    readings.arrivals[0].faults.insert(Reason::frame_incomplete);
  });
  EXPECT_EQ(state.camera.t_last_frame_received, newest);
}

TEST_F(ControlStep, ADisconnectionHoldsUntilTheCameraIsBack) {
  reach_permitted();
  inputs.has_frames = false;
  cycle([&](Readings& readings) {
    readings.arrival_count = 1;
    readings.arrivals[0].t_received = now;
    readings.arrivals[0].is_connected = false;
  });
  EXPECT_EQ(output.decision.cause, Reason::camera_disconnected);
  cycle();
  EXPECT_TRUE(output.decision.reasons.contains(Reason::camera_disconnected));
}

TEST_F(ControlStep, MoreArrivalsThanFitAreAnInternalFault) {
  RecordProperty("requirement", "SR-72");
  reach_permitted();
  cycle([&](Readings& readings) {
    readings.arrival_count = Readings::kMaxArrivals + 1;
    for (FrameArrival& arrival : readings.arrivals) arrival.t_received = now;
  });
  EXPECT_EQ(output.decision.mode, Mode::stop_latched);
  EXPECT_EQ(output.decision.cause, Reason::internal_fault);
}

TEST_F(ControlStep, AnOverflowReportedByTheLoopStops) {
  RecordProperty("requirement", "SR-72");
  reach_permitted();
  cycle([](Readings& readings) { readings.loop.internal_fault = true; });
  EXPECT_EQ(output.decision.cause, Reason::internal_fault);
}

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

TEST_F(ControlStep, ASilentRobotHoldsFromTheDeadlineOfItsStatus) {
  reach_permitted();
  inputs.has_robot = false;
  const Timestamp deadline = now + parameters.limits.robot_silence_max;
  run(parameters.limits.robot_silence_max);
  EXPECT_EQ(output.decision.mode, Mode::permitted);
  cycle();
  EXPECT_EQ(output.decision.cause, Reason::robot_silent);
  EXPECT_EQ(output.t_evidence, deadline);
}

TEST_F(ControlStep, ALateLoopStopsWithTheLimitAsEvidence) {
  RecordProperty("requirement", "SR-71");
  reach_permitted();
  cycle([](Readings& readings) { readings.loop.wake_lateness = std::chrono::milliseconds(7); });
  EXPECT_EQ(output.decision.cause, Reason::loop_overrun);
  EXPECT_EQ(output.t_evidence, now - std::chrono::milliseconds(2));
}

TEST_F(ControlStep, AnotherRegistrationStopsAndStartsTheFilterAnew) {
  reach_permitted();
  inputs.registration.id = 4712;
  cycle([](Readings& readings) { readings.estimate.reset(); });
  EXPECT_EQ(output.decision.cause, Reason::registration_changed);
  EXPECT_FALSE(output.prediction);
  EXPECT_FALSE(state.filter.has_state());
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
        sigma_of_the_next_cycle() * (is_above ? 1 + 1e-6 : 1 - 1e-6);
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

TEST_F(ControlStep, PublishesAdvisoriesBesideThePermission) {
  RecordProperty("requirement", "SR-75");
  parameters.advisories.insert(Reason::not_real_time);
  parameters.advisories.insert(Reason::unsecured_transport);
  reach_permitted();
  EXPECT_TRUE(output.decision.reasons.contains(Reason::not_real_time));
  EXPECT_TRUE(output.decision.reasons.contains(Reason::unsecured_transport));
}

/// Every number of an output, in a fixed order; memcmp of the struct would compare padding.
std::vector<double> numbers(const ControlOutput& output) {
  std::vector<double> all{static_cast<double>(output.decision.mode),
                          static_cast<double>(output.decision.cause),
                          static_cast<double>(output.decision.reasons.bits()),
                          static_cast<double>(output.t_evidence.count()), output.sigma_target_mm};
  const auto append = [&](const auto& m) { all.insert(all.end(), m.data(), m.data() + m.size()); };
  if (output.prediction) {
    append(output.prediction->T_camera_site.matrix());
    append(output.prediction->covariance);
    all.push_back(output.prediction->speed_mm_per_s);
  }
  if (output.decision.approved) {
    append(output.decision.approved->T_robot_ct().matrix());
    append(output.decision.approved->covariance());
  }
  return all;
}

TEST_F(ControlStep, TheSameInputsGiveTheSameBits) {
  const auto record = [this] {
    restart();
    std::vector<double> all;
    for (int i = 0; i < 1500; ++i) {
      if (i == 900) inputs.has_frames = false;
      cycle([&](Readings& readings) {
        if (i == 600) readings.operator_command.command = safety::Command::arm;
      });
      const auto these = numbers(output);
      all.insert(all.end(), these.begin(), these.end());
    }
    return all;
  };
  const auto first = record();
  const auto second = record();
  ASSERT_EQ(first.size(), second.size());
  EXPECT_EQ(std::memcmp(first.data(), second.data(), first.size() * sizeof(double)), 0);
}

}  // namespace
}  // namespace holdfast::rt
