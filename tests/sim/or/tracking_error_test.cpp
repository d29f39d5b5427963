// SPDX-License-Identifier: Apache-2.0
// The judge of trajectories: what it says of ones whose errors are known.
#include "tests/sim/or/tracking_error.hpp"

#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <sstream>
#include <string>

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include "rt/core/error.hpp"

namespace holdfast::sim {
namespace {

namespace fs = std::filesystem;
constexpr double kDepthMm = 200;

class TrackingErrorTest : public ::testing::Test {
 protected:
  const fs::path file = fs::path(::testing::TempDir()) / fmt::format("poses-{}.csv", getpid());
  const Trajectory truth{"linear:0.1", 1, false, kDepthMm};
  Eigen::Isometry3d T_camera_ideal = Eigen::Isometry3d::Identity();

  void TearDown() override { fs::remove(file); }

  /// Twenty frames, 30 a second; `wrong` alters the true pose of each, or its status.
  using Change = std::function<void(int frame, Eigen::Isometry3d& T, std::string& status)>;
  TrackingError judged(const Change& wrong) {
    std::ofstream csv(file);
    csv << "frame,t_ns,status,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw\n";
    for (int i = 0; i <= 20; ++i) {
      const std::chrono::nanoseconds t{i * 33'000'000LL};
      const SitePose pose = truth.at(t);
      Eigen::Isometry3d T = T_camera_ideal *
                            Eigen::Isometry3d(Eigen::Translation3d(pose.t_mm) * pose.q) *
                            T_camera_ideal.inverse();
      std::string status = "tracking";
      if (i > 0) wrong(i, T, status);
      csv << i << ',' << 5'000'000 + t.count() << ',' << status;
      const Eigen::Quaterniond q(T.linear());
      if (status == "lost")
        csv << ",,,,,,,\n";
      else
        csv << fmt::format(",{:.9f},{:.9f},{:.9f},{:.12f},{:.12f},{:.12f},{:.12f}\n",
                           T.translation().x(), T.translation().y(), T.translation().z(), q.x(),
                           q.y(), q.z(), q.w());
    }
    csv.close();
    return tracking_error(file, truth, T_camera_ideal, kDepthMm);
  }
};

TEST_F(TrackingErrorTest, TheTruthItselfHasNoneInWhateverFrameItIsTold) {
  for (const double turn_rad : {0.0, 0.01}) {
    T_camera_ideal = Eigen::AngleAxisd(turn_rad, Eigen::Vector3d(1, 2, 3).normalized()) *
                     Eigen::Translation3d(0.4, 0, -0.2);
    const TrackingError e = judged([](int, Eigen::Isometry3d&, std::string&) {});
    EXPECT_EQ(e.frames, 20);
    EXPECT_EQ(e.lost, 0);
    EXPECT_NEAR(e.absolute_max_um, 0, 1e-3);
    EXPECT_NEAR(e.step_mean_um, 0, 1e-3);
    EXPECT_NEAR(e.rotation_rms_mrad, 0, 1e-4);
  }
}

TEST_F(TrackingErrorTest, MeasuresAConstantErrorOnceAndADriftInEachStep) {
  const TrackingError offset = judged([](int, Eigen::Isometry3d& T, std::string&) {
    T.pretranslate(Eigen::Vector3d(0.3, 0.4, 0.05));
  });
  EXPECT_NEAR(offset.absolute_rms_um, 500, 0.01);
  EXPECT_NEAR(offset.depth_rms_um, 50, 0.01);
  EXPECT_NEAR(offset.step_mean_um, 500.0 / 20, 0.01) << "in the first step only";
  EXPECT_EQ(offset.silently_wrong, 20);
  const TrackingError drift = judged([](int i, Eigen::Isometry3d& T, std::string&) {
    T.pretranslate(Eigen::Vector3d(0.002 * i, 0, 0));
  });
  EXPECT_NEAR(drift.step_mean_um, 2, 0.01);
  EXPECT_NEAR(drift.step_sd_um, 0, 0.01);
  EXPECT_NEAR(drift.absolute_max_um, 40, 0.01);
  EXPECT_EQ(drift.silently_wrong, 0);
}

TEST_F(TrackingErrorTest, CountsLostFramesAndBelievesNoDegradedOne) {
  const TrackingError e = judged([](int i, Eigen::Isometry3d& T, std::string& status) {
    if (i == 5 || i == 6) status = "lost";
    if (i < 10) return;
    T.pretranslate(Eigen::Vector3d(1, 0, 0));
    if (i < 15) status = "degraded";
  });
  EXPECT_EQ(e.lost, 2);
  EXPECT_EQ(e.silently_wrong, 6) << "frames 15 to 20";
  std::istringstream rows(e.rows);
  int lines = 0;
  for (std::string line; std::getline(rows, line);) ++lines;
  EXPECT_EQ(lines, 1 + 18);
}

TEST_F(TrackingErrorTest, RefusesWhatIsNoTrajectory) {
  EXPECT_THROW((void)tracking_error("/no/such/poses.csv", truth, T_camera_ideal, kDepthMm),
               InputError);
  std::ofstream(file) << "frame,t_ns,status\n0,0,tracking\n1,1,tracking\n";
  EXPECT_THROW((void)tracking_error(file, truth, T_camera_ideal, kDepthMm), InputError);
  EXPECT_THROW(
      judged([](int, Eigen::Isometry3d& T, std::string&) { T.translation().x() = std::nan(""); }),
      InputError);
}

}  // namespace
}  // namespace holdfast::sim
