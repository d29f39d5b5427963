// SPDX-License-Identifier: Apache-2.0
#include "rt/guard/guard_core.hpp"

#include <cmath>
#include <functional>
#include <limits>

#include <gtest/gtest.h>

namespace holdfast::guard {
namespace {

using bridge::dds::Clocks;
using bridge::dds::protect;
using namespace std::chrono_literals;

/// A good daemon and a good robot, in virtual time; a test spoils one thing.
class GuardCoreTest : public ::testing::Test {
 public:
  static constexpr std::uint64_t kRegistration = 9;

  /// One millisecond of the world, then the guard's answer.
  const GuardAnswer& step() {
    now_ += 1ms;
    ++steps_;
    if (steps_ == 1) registration();
    if (steps_ % 30 == 1 && has_health) health();
    if (steps_ % 5 == 0 && has_stops) stop();
    if (is_permitted && has_poses) pose();
    if (steps_ % 10 == 0 && has_robot) robot();
    return core_.decide(now_);
  }
  const GuardAnswer& run(std::chrono::milliseconds duration) {
    for (int i = 0; i < duration.count() - 1; ++i) (void)step();
    return step();
  }
  /// Until permitted.
  void permit() { ASSERT_TRUE(run(100ms).is_permitted) << name(answer().cause); }
  /// The milliseconds until the guard no longer permits; -1 when it still does after 300.
  int withdrawn_after() {
    for (int ms = 1; ms <= 300; ++ms) {
      if (!step().is_permitted) return ms;
    }
    return -1;
  }
  const GuardAnswer& answer() { return core_.decide(now_); }
  [[nodiscard]] Clocks clocks() const { return {now_, now_ + 1'700'000'000s}; }

  void registration() {
    msg::RegistrationInfo m{};
    m.is_loaded = true;
    m.registration_id = kRegistration;
    m.translation_mm[2] = 200;  // the target is the ct origin, 200 mm before the camera
    m.rotation_xyzw[3] = 1;
    protect(m, 7, ++registration_counter_, 1h, clocks());
    core_.take(m, clocks());
  }
  void health() {
    msg::TrackingHealth m{};
    m.status = health_status;
    m.registration_id = health_registration;
    m.site_translation_mm[0] = site_x_mm;
    m.site_rotation_xyzw[3] = 1;
    protect(m, 7, ++health_counter_, 200ms, clocks());
    core_.take(m, clocks());
  }
  void stop() {
    msg::MotionStop m{};
    m.is_permitted = is_permitted;
    m.mode = is_permitted ? 3 : 2;
    m.cause = is_permitted ? 0 : 48;
    protect(m, 7, ++stop_counter_, 20ms, clocks());
    core_.take(m, clocks());
  }
  void pose() {
    msg::CompensatedPose m{};
    m.t_pose_ns = now_.count();
    m.t_exposure_ns = (now_ - exposure_age).count();
    m.t_frame_received_ns = (now_ - 15ms).count();
    m.registration_id = kRegistration;
    m.translation_mm[0] = site_x_mm;
    m.translation_mm[2] = 200;
    m.target_robot_mm[0] = site_x_mm;
    m.target_robot_mm[2] = 200;
    m.rotation_xyzw[3] = 1;
    if (spoil) spoil(m);
    protect(m, pose_source, ++pose_counter_, 15ms, clocks());
    if (spoil_wire) spoil_wire(m);
    core_.take(m, clocks());
  }
  void robot() {
    msg::RobotStatus m{};
    m.is_enabled = is_robot_enabled;
    m.has_fault = has_robot_fault;
    protect(m, 8, ++robot_counter_, 100ms, clocks());
    core_.take(m, clocks());
  }

  bool is_permitted = true, has_stops = true, has_poses = true, has_health = true, has_robot = true;
  bool is_robot_enabled = false, has_robot_fault = false;
  double site_x_mm = 0;
  std::chrono::nanoseconds exposure_age = 30ms;
  std::uint8_t health_status = 0;
  std::uint64_t health_registration = kRegistration;
  std::uint32_t pose_source = 7;
  std::function<void(msg::CompensatedPose&)> spoil, spoil_wire;

  GuardCore core_{GuardLimits{}, Eigen::Isometry3d::Identity()};
  std::chrono::nanoseconds now_ = 1000s;
  int steps_ = 0;
  std::uint32_t registration_counter_ = 0, health_counter_ = 0, stop_counter_ = 0,
                pose_counter_ = 0, robot_counter_ = 0;
};

TEST_F(GuardCoreTest, RefusesBeforeItHasHeardAnything) {
  RecordProperty("requirement", "SR-100");
  const GuardAnswer& first = core_.decide(now_);
  EXPECT_FALSE(first.is_permitted);
  EXPECT_EQ(first.cause, GuardCause::daemon_silent);
}

TEST_F(GuardCoreTest, PermitsWhenAllHasBeenWellForTheRecoveryTime) {
  RecordProperty("requirement", "SR-100");
  is_permitted = false;
  EXPECT_EQ(run(100ms).cause, GuardCause::daemon_not_permitting);
  is_permitted = true;
  EXPECT_FALSE(run(20ms).is_permitted);
  EXPECT_TRUE(run(30ms).is_permitted);
  EXPECT_EQ(answer().daemon_source, 7U);
}

TEST_F(GuardCoreTest, WithdrawsWithinItsBoundWhenAStreamEnds) {
  RecordProperty("requirement", "SR-101");
  struct Case {
    bool GuardCoreTest::*stream;
    GuardCause cause;
    int bound_ms;
  };
  for (const auto& [stream, cause, bound_ms] :
       {Case{&GuardCoreTest::has_poses, GuardCause::pose_silent, 6},
        Case{&GuardCoreTest::has_stops, GuardCause::daemon_silent, 9},
        Case{&GuardCoreTest::has_health, GuardCause::health_silent, 251},
        Case{&GuardCoreTest::has_robot, GuardCause::robot_silent, 121}}) {
    permit();
    this->*stream = false;
    const int after_ms = withdrawn_after();
    EXPECT_GT(after_ms, 0) << name(cause);
    EXPECT_LE(after_ms, bound_ms) << name(cause);
    EXPECT_EQ(answer().cause, cause);
    this->*stream = true;
  }
}

TEST_F(GuardCoreTest, TheDaemonsWithdrawalIsOurs) {
  RecordProperty("requirement", "SR-101");
  permit();
  is_permitted = false;
  EXPECT_LE(withdrawn_after(), 6);
}

TEST_F(GuardCoreTest, ABadMessageWithdrawsAtOnce) {
  RecordProperty("requirement", "SR-102");
  permit();
  spoil_wire = [](msg::CompensatedPose& m) { m.translation_mm[0] += 1e-9; };
  EXPECT_EQ(withdrawn_after(), 1);
  spoil_wire = nullptr;
  EXPECT_TRUE(run(100ms).is_permitted);
}

TEST_F(GuardCoreTest, ASkippedPoseIsABadMessage) {
  RecordProperty("requirement", "SR-102");
  permit();
  ++pose_counter_;
  EXPECT_EQ(withdrawn_after(), 1);
}

TEST_F(GuardCoreTest, AnImplausiblePoseWithdrawsAndStaysUntilTheDaemonHasWithdrawn) {
  RecordProperty("requirement", "SR-103");
  const std::function<void(msg::CompensatedPose&)> spoilers[] = {
      [](msg::CompensatedPose& m) { m.target_robot_mm[0] += 0.01; },  // target against pose
      [](msg::CompensatedPose& m) {                                   // far from the keyframe
        m.translation_mm[0] += 19;
        m.target_robot_mm[0] += 19;
      },
      [](msg::CompensatedPose& m) {  // far from what the tracker saw
        m.translation_mm[1] += 4.1;
        m.target_robot_mm[1] += 4.1;
      },
      [](msg::CompensatedPose& m) {  // turned
        m.rotation_xyzw[2] = std::sin(0.25);
        m.rotation_xyzw[3] = std::cos(0.25);
      },
      [](msg::CompensatedPose& m) { m.translation_mm[2] = std::nan(""); },
      [](msg::CompensatedPose& m) { m.rotation_xyzw[3] = 1.1; }};
  for (const auto& spoiler : spoilers) {
    permit();
    spoil = spoiler;
    EXPECT_EQ(withdrawn_after(), 1);
    EXPECT_EQ(answer().cause, GuardCause::pose_implausible);
    spoil = nullptr;
    EXPECT_FALSE(run(200ms).is_permitted);  // good poses alone do not heal it
    is_permitted = false;
    (void)run(10ms);
    is_permitted = true;
  }
  permit();
}

TEST_F(GuardCoreTest, AJumpOfTheTargetIsRefusedAndAMotionIsNot) {
  RecordProperty("requirement", "SR-103");
  permit();
  for (int ms = 0; ms < 60; ++ms) {  // 30 mm/s
    site_x_mm += 0.03;
    ASSERT_TRUE(step().is_permitted) << name(answer().cause);
  }
  site_x_mm += 0.7;
  EXPECT_FALSE(step().is_permitted);
  EXPECT_EQ(answer().cause, GuardCause::pose_jump);
}

TEST_F(GuardCoreTest, RefusesWhatIsLostOldOrOfAnotherRegistration) {
  RecordProperty("requirement", "SR-103");
  permit();
  health_status = 3;
  EXPECT_LE(withdrawn_after(), 31);
  EXPECT_EQ(answer().cause, GuardCause::tracking_lost);
  health_status = 0;
  permit();
  exposure_age = 121ms;
  EXPECT_EQ(withdrawn_after(), 1);
  EXPECT_EQ(answer().cause, GuardCause::pose_old);
  exposure_age = 30ms;
  permit();
  health_registration = kRegistration + 1;
  EXPECT_LE(withdrawn_after(), 31);
  EXPECT_EQ(answer().cause, GuardCause::not_registered);
}

TEST_F(GuardCoreTest, PosesOfAnotherSenderThanTheStopsAreNotVouchedFor) {
  RecordProperty("requirement", "SR-102");
  permit();
  pose_source = 77;
  EXPECT_EQ(withdrawn_after(), 1);
}

TEST_F(GuardCoreTest, ARobotsFaultWithdraws) {
  RecordProperty("requirement", "SR-104");
  permit();
  has_robot_fault = true;
  EXPECT_LE(withdrawn_after(), 10);
  EXPECT_EQ(answer().cause, GuardCause::robot_fault);
}

TEST_F(GuardCoreTest, ARobotThatStaysEnabledAgainstItIsLeftToTheWatchdog) {
  RecordProperty("requirement", "SR-104");
  permit();
  is_robot_enabled = true;
  EXPECT_TRUE(run(100ms).is_permitted);
  is_permitted = false;
  EXPECT_TRUE(run(45ms).may_stroke_watchdog);
  EXPECT_FALSE(run(30ms).may_stroke_watchdog);
  EXPECT_EQ(answer().cause, GuardCause::robot_disobeys);
  is_robot_enabled = false;
  is_permitted = true;
  EXPECT_FALSE(run(500ms).is_permitted);  // for good
}

TEST_F(GuardCoreTest, ARobotThatObeysIsNotAccused) {
  permit();
  is_robot_enabled = true;
  EXPECT_TRUE(run(50ms).is_permitted);
  is_permitted = false;
  (void)run(15ms);
  is_robot_enabled = false;
  EXPECT_TRUE(run(200ms).may_stroke_watchdog);
}

TEST(GuardLimitsTest, AreRefusedOutsideTheirRangeAndAsNaN) {
  EXPECT_EQ(invalid_limit({}), "");
  GuardLimits limits;
  limits.daemon_silence_max = 21ms;
  EXPECT_NE(invalid_limit(limits).find("daemon_silence_max"), std::string::npos);
  limits = {};
  limits.speed_max_mm_per_s = std::numeric_limits<double>::quiet_NaN();
  EXPECT_NE(invalid_limit(limits).find("speed_max"), std::string::npos);
}

}  // namespace
}  // namespace holdfast::guard
