// SPDX-License-Identifier: Apache-2.0
// The judge itself: it must find a hazard where there is one, and only there.
#include "tests/sim/demo/evaluation.hpp"

#include <cmath>
#include <fstream>

#include <gtest/gtest.h>
#include <unistd.h>

#include "tests/sim/csv_table.hpp"

namespace holdfast::sim {
namespace {

using namespace std::chrono_literals;

constexpr std::int64_t kStart = 1'000'000'000;
constexpr std::int64_t kMs = 1'000'000;

class EvaluationTest : public ::testing::Test {
 public:
  void SetUp() override {
    std::filesystem::create_directories(folder);
    config.p_target_ct_mm = {0, 0, 200};
    move([](std::int64_t /*ms*/) { return 0.25; });
    std::ofstream events(folder / "events.csv");
    events << "t_monotonic_ns,event,detail\n" << kStart << ",segment,\"still, a comma\"\n";
    for (std::int64_t frame = 0; frame < 60; ++frame)
      events << t_exposure(frame) << ",frame,id=" << frame
             << " mid_exposure_ns=" << t_exposure(frame) << " stamp_ns=0\n";
    robot = std::ofstream(folder / "robot.csv");
    robot
        << "event,t_monotonic_ns,refusal,t_permission_end_ns,frame,first_of_frame,t_pose_ns,"
           "t_exposure_ns,t_frame_received_ns,t_valid_until_ns,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw,cause,"
           "t_evidence_ns\n";
  }
  void TearDown() override { std::filesystem::remove_all(folder); }

  /// The frames: one every 33 ms, each used from 20 ms after its exposure on.
  static std::int64_t t_exposure(std::int64_t frame) { return kStart + (33 * frame - 20) * kMs; }
  static std::int64_t newest_frame(std::int64_t ms) { return ms / 33; }

  /// The site's true way along x.
  template <typename XOf>
  void move(XOf x_mm_at) {
    std::ofstream truth(folder / "truth.csv");
    truth << "t_monotonic_ns,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw\n";
    for (std::int64_t ms = 0; ms <= 2000; ++ms)
      truth << kStart + ms * kMs << ',' << x_mm_at(ms) << ",0,0,0,0,0,1\n";
  }
  /// The robot acts on a pose that is wrong by `error_mm` for a site at rest, from `from_ms` on,
  /// every millisecond.
  void act(std::int64_t from_ms, std::int64_t to_ms, double error_mm) {
    for (std::int64_t ms = from_ms; ms < to_ms; ++ms) {
      const std::int64_t t = kStart + ms * kMs;
      const std::int64_t frame = newest_frame(ms);
      robot << "pose," << t << ",none,," << frame << ',' << (ms % 33 == 0 ? 1 : 0) << ',' << t
            << ',' << t_exposure(frame) << ',' << t_exposure(frame) + 5 * kMs << ',' << t + 15 * kMs
            << ',' << 0.25 + error_mm << ",0,0,0,0,0,1,none,0\n";
    }
  }
  void stop(std::int64_t ms, const char* cause, std::int64_t evidence_ms) {
    robot << "stopped," << kStart + ms * kMs << ",not_permitted," << kStart + ms * kMs
          << ",,,,,,,,,,,,,," << cause << ',' << kStart + evidence_ms * kMs << '\n';
  }
  Evaluation judge(std::vector<ExpectedStop> expected = {}) {
    robot.close();
    return evaluate(config, folder / "truth.csv", folder / "events.csv", folder / "robot.csv",
                    std::move(expected), {}, HazardLimits{});
  }

  const std::filesystem::path folder = std::filesystem::path(::testing::TempDir()) /
                                       ("holdfast-evaluation-" + std::to_string(getpid()));
  rt::DaemonConfig config;
  std::ofstream robot;
};

TEST_F(EvaluationTest, FindsNothingWrongWithTruePoses) {
  act(100, 600, 0);
  const Evaluation e = judge();
  EXPECT_EQ(e.hazards, 0);
  EXPECT_LT(e.tracking_rms_um, 1e-6);
  ASSERT_EQ(e.trajectories.size(), 1U);
  EXPECT_EQ(e.trajectories[0].name, "still, a comma");
  EXPECT_EQ(e.trajectories[0].poses, 500U);
  EXPECT_NEAR(percentile(e.latency_ms, 0.5), 20, 1e-6);
}

TEST_F(EvaluationTest, CountsAPermissionThatStaysWrongTooLongOnce) {
  act(100, 200, 0);
  act(200, 400, 0.6);  // limit 0.5 mm, for longer than estimate_age_max, 90 ms
  act(400, 500, 0);
  const Evaluation e = judge();
  EXPECT_EQ(e.hazards, 1);
  EXPECT_NEAR(e.over_limit_ms_max, 200, 2);
}

TEST_F(EvaluationTest, ToleratesAnErrorThatNoFrameCouldShow) {
  constexpr std::int64_t kKnock = 330;  // frame 10 is in use, exposed 20 ms before
  move([](std::int64_t ms) { return ms > kKnock ? 1.25 : 0.25; });
  act(100, 363, 0);  // frame 11 has seen it ...
  stop(363, "pose_jump", 362);
  const Evaluation e = judge();
  EXPECT_EQ(e.hazards, 0);
  EXPECT_NEAR(e.over_limit_ms_max, 363 - kKnock, 1.5);
  EXPECT_LT(e.avoidable_um_max, 1e-6);
}

TEST_F(EvaluationTest, ToleratesNoErrorThatAFrameHasShown) {
  constexpr std::int64_t kKnock = 330;
  move([](std::int64_t ms) { return ms > kKnock ? 1.25 : 0.25; });
  act(100, 364, 0);  // ... and is used for one millisecond as if it had not
  stop(364, "pose_jump", 363);
  const Evaluation e = judge();
  EXPECT_EQ(e.hazards, 1);
  EXPECT_LT(e.over_limit_ms_max, 40);
  EXPECT_GT(e.avoidable_um_max, 999);
}

TEST_F(EvaluationTest, ToleratesNoErrorLongerThanAMotionMayGoUnseen) {
  constexpr std::int64_t kKnock = 330;
  move([](std::int64_t ms) { return ms > kKnock ? 1.25 : 0.25; });
  for (std::int64_t ms = kKnock; ms < kKnock + 95; ++ms) {  // frame 10's exposure, for ever
    const std::int64_t t = kStart + ms * kMs;
    robot << "pose," << t << ",none,,10,0," << t << ',' << t_exposure(10) << ',' << t_exposure(10)
          << ',' << t + 15 * kMs << ",0.25,0,0,0,0,0,1,none,0\n";
  }
  stop(kKnock + 95, "estimate_stale", kKnock + 94);
  const Evaluation e = judge();
  EXPECT_LT(e.avoidable_um_max, 1e-6);
  EXPECT_EQ(e.hazards, 1);
}

TEST_F(EvaluationTest, CountsAnErrorOnAFrameThatTheCameraNeverSent) {
  act(100, 200, 0);
  robot << "pose," << kStart + 200 * kMs << ",none,,999,1," << kStart + 200 * kMs << ",0,0,"
        << kStart + 215 * kMs << ",0.85,0,0,0,0,0,1,none,0\n";
  EXPECT_EQ(judge().hazards, 1);
}

TEST_F(EvaluationTest, ExpectsAPerfectObserverToLetTheVelocityGoOn) {
  move([](std::int64_t ms) { return 0.25 + 0.01 * static_cast<double>(ms); });  // 10 mm/s
  for (std::int64_t ms = 300; ms < 400; ++ms) {
    const std::int64_t t = kStart + ms * kMs;
    robot << "pose," << t << ",none,," << newest_frame(ms) << ",0," << t << ",0,0," << t + 15 * kMs
          << ',' << 0.25 + 0.01 * static_cast<double>(ms) << ",0,0,0,0,0,1,none,0\n";
  }
  const Evaluation e = judge();
  EXPECT_EQ(e.hazards, 0);
  EXPECT_LT(e.avoidable_um_max, 200);  // of the last pose, used for 15 ms: 150
}

TEST_F(EvaluationTest, MeasuresTheErrorAtTheTarget) {
  act(100, 400, 0.1);
  EXPECT_NEAR(judge().tracking_rms_um, 100, 1e-6);
}

TEST_F(EvaluationTest, TellsAnExpectedStopFromAFalseOne) {
  act(100, 200, 0);
  stop(200, "frame_frozen", 198);
  act(400, 500, 0);
  stop(500, "frame_late", 499);
  const auto at = [](std::int64_t ms) { return std::chrono::nanoseconds{kStart + ms * kMs}; };
  const Evaluation e = judge({{"freeze", at(180), at(300)}});
  ASSERT_EQ(e.stops.size(), 2U);
  EXPECT_EQ(e.stops[0].expected, "freeze");
  EXPECT_NEAR(e.stops[0].reaction_ms, 2, 1e-6);
  EXPECT_NEAR(e.stops[0].injected_to_stop_ms, 20, 1e-6);
  EXPECT_EQ(e.stops[1].expected, "");
  EXPECT_EQ(e.false_stops, 1);
}

TEST(Percentile, IsTheNearestRank) {
  EXPECT_EQ(percentile({5, 1, 3, 2, 4}, 0.5), 3);
  EXPECT_EQ(percentile({5, 1, 3, 2, 4}, 1), 5);
  EXPECT_EQ(percentile({5, 1, 3, 2, 4}, 0.2), 1);
  EXPECT_TRUE(std::isnan(percentile({}, 0.5)));
}

}  // namespace
}  // namespace holdfast::sim
