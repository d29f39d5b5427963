// SPDX-License-Identifier: Apache-2.0
// The control step as a whole: it approves, follows robot, loop and registration, and repeats
// itself.
#include "rt/control_step.hpp"

#include <cstring>
#include <vector>

#include <gtest/gtest.h>

#include "rt/core/mailbox.hpp"
#include "tests/rt/control_step_fixture.hpp"

namespace holdfast::rt {
namespace {

using safety::Mode;
using safety::Reason;
using safety::Timestamp;
using testing::ControlStep;

static_assert(OwnsNothing<ControlOutput>);
static_assert(OwnsNothing<StampedEstimate>);
static_assert(OwnsNothing<FrameArrival>);

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

TEST_F(ControlStep, LeadsByWhatTheRobotTakesAndSaysWhatThatCosts) {
  RecordProperty("requirement", "SR-124");
  const auto follow = [this](std::chrono::nanoseconds lead) {
    restart();
    parameters.limits.pose_lead = lead;
    reach_permitted();
    struct Sums {
      double against_use = 0, against_now = 0, sigma = 0;
    } sums;
    for (int i = 0; i < 500; ++i) {
      cycle();
      if (!output.decision.approved) ADD_FAILURE() << safety::name(output.decision.cause);
      if (!output.decision.approved) break;
      const Eigen::Vector3d p_target = inputs.registration.p_target_site_mm;
      const Eigen::Vector3d approved = output.decision.approved->T_robot_ct().translation();
      sums.against_use += (approved - testing::site_at(now + lead) * p_target).norm();
      sums.against_now += (approved - testing::site_at(now) * p_target).norm();
      sums.sigma += output.sigma_target_mm;
    }
    return sums;
  };
  const auto at_once = follow(std::chrono::milliseconds(0));
  const auto leading = follow(std::chrono::milliseconds(10));
  EXPECT_LT(leading.against_use, 2 * at_once.against_use);  // the site turns back meanwhile
  EXPECT_GT(leading.against_now, 2 * leading.against_use);
  EXPECT_GT(leading.sigma, 1.05 * at_once.sigma);
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
