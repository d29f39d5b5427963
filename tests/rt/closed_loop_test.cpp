// SPDX-License-Identifier: Apache-2.0
// The loop in virtual time over a sequence of estimates: what a robot would have been told.
#include "rt/study/closed_loop.hpp"

#include <cmath>
#include <sstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "tests/rt/virtual_inputs.hpp"

namespace holdfast::rt {
namespace {

using perception::MotionEstimate;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

constexpr double kRateHz = 50, kSpeedMmPerS = 2;

/// Three seconds: one at rest, then along x.
double x_mm(double t_s) {
  return kSpeedMmPerS * std::max(0.0, t_s - 1);
}

std::vector<MotionEstimate> followed() {
  std::vector<MotionEstimate> estimates;
  for (int i = 0; i <= 150; ++i) {
    const nanoseconds t = i * milliseconds(20);
    MotionEstimate& e = estimates.emplace_back(testing::healthy_estimate(t));
    e.T_camera_site = Eigen::Translation3d(x_mm(i / kRateHz), 0, 0);
    e.covariance = testing::diagonal_covariance(0.001, 1e-5);
  }
  return estimates;
}

struct Command {
  double t_s = 0;
  bool is_permitted = false;
  double x_mm = 0;
};

std::vector<Command> commands_of(const ClosedLoopRun& run) {
  std::istringstream lines(run.commands);
  std::string line;
  std::getline(lines, line);
  EXPECT_EQ(line, "t_ns,is_permitted,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw");
  std::vector<Command> commands;
  while (std::getline(lines, line)) {
    long long t_ns = 0;
    int permitted = -1;
    double x = std::nan("");
    EXPECT_GE(std::sscanf(line.c_str(), "%lld,%d,%lf", &t_ns, &permitted, &x), 2) << line;
    commands.push_back({1e-9 * static_cast<double>(t_ns), permitted == 1, x});
  }
  return commands;
}

ClosedLoopSettings settings(nanoseconds lead) {
  ClosedLoopSettings s;
  s.rate_hz = kRateHz;
  s.pose_lead = lead;
  s.p_target_site_mm = {0, 0, 200};
  return s;
}

TEST(ClosedLoop, TellsARobotEachMillisecondWhereTheTargetIsOrWillBe) {
  for (const nanoseconds lead : {milliseconds(0), milliseconds(8)}) {
    const ClosedLoopRun run = run_closed_loop(followed(), settings(lead));
    const auto commands = commands_of(run);
    ASSERT_EQ(commands.size(), 3001U);
    EXPECT_EQ(run.stops, 0) << run.stop_causes;
    const double lead_s = std::chrono::duration<double>(lead).count();
    for (const Command& command : commands) {
      if (command.t_s < 0.5) continue;  // until it is verified and armed
      ASSERT_TRUE(command.is_permitted) << command.t_s;
      const bool has_settled = command.t_s < 0.95 || command.t_s > 1.3;  // or learns the speed
      if (!has_settled) continue;
      EXPECT_NEAR(command.x_mm, x_mm(command.t_s + lead_s), 2e-3) << command.t_s;
    }
  }
}

TEST(ClosedLoop, ALostSiteIsNotPermittedAndCostsAStopOnlyWhenItStaysLost) {
  const auto lose = [](int from, int until) {
    auto estimates = followed();
    for (int i = from; i < until; ++i)
      estimates[static_cast<std::size_t>(i)].status = perception::TrackingStatus::lost;
    return estimates;
  };
  const ClosedLoopRun brief = run_closed_loop(lose(50, 55), settings(nanoseconds(0)));
  EXPECT_EQ(brief.stops, 0) << brief.stop_causes;
  for (const Command& command : commands_of(brief)) {
    const bool is_told = command.t_s > 1.02 && command.t_s < 1.09;
    EXPECT_FALSE(is_told && command.is_permitted) << command.t_s;
  }
  const ClosedLoopRun lasting = run_closed_loop(lose(50, 90), settings(nanoseconds(0)));
  EXPECT_EQ(lasting.stops, 1);
  EXPECT_EQ(lasting.stop_causes, "hold_timeout");
  EXPECT_TRUE(commands_of(lasting).back().is_permitted);  // acknowledged, confirmed, armed
}

TEST(ClosedLoop, NoEstimateNoCommand) {
  EXPECT_TRUE(run_closed_loop({}, settings(nanoseconds(0))).commands.empty());
}

}  // namespace
}  // namespace holdfast::rt
