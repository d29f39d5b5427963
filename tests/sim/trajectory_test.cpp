// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/trajectory.hpp"

#include <cmath>

#include <gtest/gtest.h>

#include "rt/core/error.hpp"
#include "tests/sim/camera_control.hpp"
#include "tests/sim/moving_site.hpp"

namespace holdfast::sim {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using std::chrono::seconds;

double seconds_of(nanoseconds t) {
  return std::chrono::duration<double>(t).count();
}

TEST(Trajectory, LinearIsPaperBsCrossAtItsSpeed) {
  const Trajectory cross("linear", 1, false, 200);
  EXPECT_NEAR(seconds_of(cross.duration()), (10 + 20 + std::hypot(10, 20 - 10) + 20 + 10) / 2.0,
              1e-6);
  EXPECT_TRUE(cross.at(seconds(5)).t_mm.isApprox(Eigen::Vector3d(0, 10, 0), 1e-9));
  EXPECT_TRUE(cross.at(seconds(15)).t_mm.isApprox(Eigen::Vector3d(0, -10, 0), 1e-9));
  EXPECT_TRUE(cross.at(seconds(2)).t_mm.isApprox(Eigen::Vector3d(0, 4, 0), 1e-9));
}

TEST(Trajectory, SpiralReachesItsLastWaypointThenReturns) {
  const Trajectory spiral("spiral", 1, false, 200);
  const double t_last_s = seconds_of(spiral.duration()) - 5 / 2.0;
  const auto last = spiral.at(nanoseconds(std::llround(t_last_s * 1e9)));
  EXPECT_TRUE(last.t_mm.isApprox(Eigen::Vector3d(0, 5, 0), 1e-6));
  EXPECT_LT(spiral.at(spiral.duration() - nanoseconds(1000)).t_mm.norm(), 1e-4);
}

TEST(Trajectory, EverySegmentBeginsAndEndsAtIdentityWithoutJumps) {
  for (const char* program : {"still", "linear:0.1", "spiral:0.1", "bump", "breathing", "roll",
                              "tilt", "lift", "still:0.5,bump:2,roll:3"}) {
    const Trajectory trajectory(program, 1, true, 200);
    SitePose previous = trajectory.at(nanoseconds(0));
    EXPECT_LT(previous.t_mm.norm(), 1e-9) << program;
    for (nanoseconds t{0}; t < 2 * trajectory.duration(); t += milliseconds(1)) {
      const SitePose pose = trajectory.at(t);
      EXPECT_LT((pose.t_mm - previous.t_mm).norm(), 0.12) << program << " " << t.count();
      EXPECT_NEAR(pose.q.norm(), 1, 1e-12);
      previous = pose;
    }
    EXPECT_LT(trajectory.at(trajectory.duration()).t_mm.norm(), 1e-6) << program;
  }
}

TEST(Trajectory, BumpReachesItsAmplitude) {
  const Trajectory bump("bump:2", 1, false, 200);
  double largest = 0;
  for (nanoseconds t{0}; t < bump.duration(); t += milliseconds(1))
    largest = std::max(largest, bump.at(t).t_mm.x());
  EXPECT_NEAR(largest, 2, 0.05);
}

TEST(Trajectory, EndsAtRestUnlessLooped) {
  EXPECT_EQ(Trajectory("linear:0.1", 1, false, 200).at(seconds(100)).t_mm.norm(), 0);
  const Trajectory looped("linear:0.1", 1, true, 200);
  EXPECT_GT(looped.at(looped.duration() + milliseconds(300)).t_mm.norm(), 0.1);
}

TEST(Trajectory, RollTurnsAboutThePointAtDepth) {
  const Trajectory roll("tilt:4", 1, false, 150);
  const SitePose turned = roll.at(roll.duration() / 2);
  const Eigen::Vector3d pivot(0, 0, 150);
  EXPECT_TRUE((turned.q * pivot + turned.t_mm).isApprox(pivot, 1e-9));
  EXPECT_NEAR(turned.q.angularDistance(Eigen::Quaterniond::Identity()), 4 * M_PI / 180, 1e-9);
}

TEST(Trajectory, RefusesWhatItDoesNotKnow) {
  for (const char* program : {"", "jump", "still:x", "still:-1", "linear:", "still,,bump"})
    EXPECT_THROW(Trajectory(program, 1, false, 200), InputError) << program;
  EXPECT_THROW(Trajectory("still", 0, false, 200), InputError);
}

TEST(MovingSite, ANewProgramStartsFromWhereTheSiteIs) {
  SceneParameters scene;
  scene.width_px = scene.height_px = 64;
  scene.margin_mm = 1;
  MovingSite site(scene, "linear:0.5", 1, false, seconds(10));
  const auto there = site.pose_at(seconds(12));
  site.set_program("still", seconds(12));
  EXPECT_TRUE(site.pose_at(seconds(12)).t_mm.isApprox(there.t_mm));
  EXPECT_LT(site.pose_at(seconds(20)).t_mm.norm(), 1e-9);
  EXPECT_TRUE(site.pose_at(seconds(11)).t_mm.isApprox(there.t_mm / 2));  // the past stays
  const auto starts = site.starts(seconds(0), seconds(100));
  ASSERT_EQ(starts.size(), 4U);
  EXPECT_EQ(starts[0].name, "linear");
  EXPECT_EQ(starts[1].name, "home");
  EXPECT_EQ(starts[2].name, "still");
  EXPECT_EQ(starts[3].name, "end");
}

TEST(FaultScript, IsReadInOrderOfTime) {
  const auto commands = parse_fault_script("10:freeze on; 10.5:freeze off");
  ASSERT_EQ(commands.size(), 2U);
  EXPECT_EQ(commands[1].t, milliseconds(10500));
  EXPECT_EQ(commands[1].line, "freeze off");
  for (const char* script : {"freeze on", "x:freeze on", "2:a;1:b"})
    EXPECT_THROW((void)parse_fault_script(script), InputError) << script;
}

}  // namespace
}  // namespace holdfast::sim
