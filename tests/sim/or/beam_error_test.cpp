// SPDX-License-Identifier: Apache-2.0
// The judge of the beam: what it says of a robot that is told the truth, late, wrong or nothing.
#include "tests/sim/or/beam_error.hpp"

#include <cmath>
#include <filesystem>
#include <fstream>
#include <optional>

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include "rt/core/error.hpp"

namespace holdfast::sim {
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;
constexpr double kDepthMm = 200;

class BeamErrorTest : public ::testing::Test {
 protected:
  const fs::path file = fs::path(::testing::TempDir()) / fmt::format("commands-{}.csv", getpid());
  const BeamRobot robot;
  Eigen::Isometry3d T_camera_ideal =
      Eigen::AngleAxisd(0.01, Eigen::Vector3d(1, 2, 3).normalized()) *
      Eigen::Translation3d(0.4, 0, -0.2);

  void TearDown() override { fs::remove(file); }

  /// Two seconds, one command a millisecond: the true pose `lead` later, `offset_mm` off, or none.
  BeamError judged(const std::string& program, nanoseconds lead, double offset_mm = 0,
                   std::optional<int> none_from_ms = {}) {
    const Trajectory truth(program, 1, false, kDepthMm);
    std::ofstream csv(file);
    csv << "t_ns,is_permitted,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw\n";
    for (int i = 0; i < 2000; ++i) {
      const nanoseconds t = milliseconds(i);
      if (none_from_ms && i >= *none_from_ms) {
        csv << t.count() << ",0,,,,,,,\n";
        continue;
      }
      const SitePose pose = truth.at(t + lead);
      const Eigen::Isometry3d T = T_camera_ideal *
                                  Eigen::Isometry3d(Eigen::Translation3d(pose.t_mm) * pose.q) *
                                  T_camera_ideal.inverse();
      const Eigen::Quaterniond q(T.linear());
      csv << fmt::format("{},1,{:.9f},{:.9f},{:.9f},{:.12f},{:.12f},{:.12f},{:.12f}\n", t.count(),
                         T.translation().x() + offset_mm, T.translation().y(), T.translation().z(),
                         q.x(), q.y(), q.z(), q.w());
    }
    csv.close();
    return beam_error(file, truth, T_camera_ideal, kDepthMm, robot);
  }
};

TEST_F(BeamErrorTest, ARobotThatIsToldTheTruthAtRestHitsTheTarget) {
  const BeamError e = judged("still:3", nanoseconds(0));
  EXPECT_NEAR(e.max_um, 0, 1e-3);
  EXPECT_NEAR(e.on_s, 1.98, 0.002);  // but for its settling
  EXPECT_DOUBLE_EQ(e.on_share, 1);
}

TEST_F(BeamErrorTest, ItsLagMissesAMovingTargetByLagTimesSpeedAndLeadByItHitsIt) {
  // paper B's cross begins with two seconds and more at 2 mm/s
  const BeamError late = judged("linear", nanoseconds(0));
  const double lag_ms = 1e-6 * static_cast<double>(robot.lag().count());
  EXPECT_NEAR(lag_ms, 1.5 + 1000 * 0.7 / (M_PI * 80), 1e-3);
  EXPECT_NEAR(late.rms_um, 2 * lag_ms, 0.1);
  EXPECT_GT(late.uncompensated_rms_um, 1000);
  const BeamError leading = judged("linear", robot.lag());
  EXPECT_LT(leading.rms_um, 0.2);
}

TEST_F(BeamErrorTest, SeesAWrongPoseAndATurningSite) {
  EXPECT_NEAR(judged("still:3", nanoseconds(0), 0.05).rms_um, 50, 0.5);
  EXPECT_LT(judged("tilt:2", robot.lag()).rms_um, 2);
}

TEST_F(BeamErrorTest, ALaserThatIsNotPermittedCountsForNothing) {
  const BeamError half = judged("still:3", nanoseconds(0), 0, 1000);
  EXPECT_NEAR(half.on_s, 0.98, 0.002);
  EXPECT_NEAR(half.on_share, 0.98 / 1.98, 0.002);
  const BeamError never = judged("still:3", nanoseconds(0), 0, 0);
  EXPECT_EQ(never.on_s, 0);
  EXPECT_TRUE(std::isnan(never.rms_um));
}

TEST_F(BeamErrorTest, RefusesWhatAreNoCommands) {
  const Trajectory truth("still:1", 1, false, kDepthMm);
  const auto refuses = [&](const char* text) {
    std::ofstream(file) << text;
    EXPECT_THROW((void)beam_error(file, truth, T_camera_ideal, kDepthMm, robot), InputError)
        << text;
  };
  refuses("t_ns,is_permitted,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw\n");
  refuses("t_ns,is_permitted,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw\n0,1,,,,,,,\n");
  refuses("t_ns,is_permitted,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw\n5,0,,,,,,,\n5,0,,,,,,,\n");
  refuses("frame,t_ns\n0,0\n");
}

}  // namespace
}  // namespace holdfast::sim
