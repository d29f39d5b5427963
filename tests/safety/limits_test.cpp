// SPDX-License-Identifier: Apache-2.0
#include "safety/limits.hpp"

#include <functional>
#include <limits>
#include <string>

#include <gtest/gtest.h>

namespace holdfast::safety {
namespace {

using std::chrono::microseconds;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

struct BadLimit {
  std::string name;
  std::function<void(Limits&)> change;
  std::string message;
};
std::ostream& operator<<(std::ostream& out, const BadLimit& limit) {
  return out << limit.name;
}

class BadLimits : public ::testing::TestWithParam<BadLimit> {};

TEST_P(BadLimits, AreRefusedWithValueLimitAndUnit) {
  RecordProperty("requirement", "SR-29");
  Limits limits;
  GetParam().change(limits);
  const auto message = invalid_limit(limits);
  ASSERT_TRUE(message);
  EXPECT_EQ(message->rfind(GetParam().message, 0), 0U) << *message;
  EXPECT_EQ(message->find('\n'), std::string::npos);
}

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
using L = Limits;

const auto kCaseName = [](const auto& info) { return info.param.name; };

INSTANTIATE_TEST_SUITE_P(
    Ranges, BadLimits,
    ::testing::Values(BadLimit{"FramePeriod", [](L& l) { l.frame_period = nanoseconds(0); },
                               "frame_period = 0 ms: must lie within 1 and 1000 ms"},
                      BadLimit{"FrameLateness", [](L& l) { l.frame_lateness = -milliseconds(1); },
                               "frame_lateness = -1 ms: must lie within 0.1 and 500 ms"},
                      BadLimit{"EstimateAge", [](L& l) { l.estimate_age_max = milliseconds(2001); },
                               "estimate_age_max = 2001 ms: must lie within 1 and 2000 ms"},
                      BadLimit{"PoseValidity", [](L& l) { l.pose_validity = microseconds(20'001); },
                               "pose_validity = 20.001 ms: must lie within 1 and 20 ms"},
                      BadLimit{"PoseLead", [](L& l) { l.pose_lead = microseconds(10'001); },
                               "pose_lead = 10.001 ms: must lie within 0 and 10 ms"},
                      BadLimit{"PoseLeadBack", [](L& l) { l.pose_lead = -milliseconds(1); },
                               "pose_lead = -1 ms: must lie within 0 and 10 ms"},
                      BadLimit{"RobotSilence",
                               [](L& l) { l.robot_silence_max = milliseconds(1001); },
                               "robot_silence_max = 1001 ms: must lie within 1 and 1000 ms"},
                      BadLimit{"LoopLateness", [](L& l) { l.loop_lateness_max = milliseconds(0); },
                               "loop_lateness_max = 0 ms: must lie within 0.01 and 20 ms"},
                      BadLimit{"ClockStep", [](L& l) { l.clock_step_max = milliseconds(0); },
                               "clock_step_max = 0 ms: must lie within 0.001 and 100 ms"},
                      BadLimit{"FrameFuture", [](L& l) { l.frame_future_max = milliseconds(21); },
                               "frame_future_max = 21 ms: must lie within 0 and 20 ms"},
                      BadLimit{"HoldMax", [](L& l) { l.hold_max = milliseconds(5001); },
                               "hold_max = 5001 ms: must lie within 1 and 5000 ms"},
                      BadLimit{"HoldRecovery", [](L& l) { l.hold_recovery = milliseconds(0); },
                               "hold_recovery = 0 ms: must lie within 1 and 5000 ms"},
                      BadLimit{"ConfirmMin", [](L& l) { l.confirm_min = milliseconds(49); },
                               "confirm_min = 49 ms: must lie within 50 and 10000 ms"},
                      BadLimit{"ConfirmMax", [](L& l) { l.confirm_max = milliseconds(60'001); },
                               "confirm_max = 60001 ms: must lie within 100 and 60000 ms"},
                      BadLimit{"Drift", [](L& l) { l.drift_max_mm = 0; },
                               "drift_max_mm = 0 mm: must lie within 0.001 and 5 mm"},
                      BadLimit{"Displacement", [](L& l) { l.displacement_max_mm = 101; },
                               "displacement_max_mm = 101 mm: must lie within 0.01 and 100 mm"},
                      BadLimit{"Rotation", [](L& l) { l.rotation_max_rad = 20; },
                               "rotation_max_rad = 20 rad: must lie within 0.001 and 1.5708 rad"},
                      BadLimit{"Speed", [](L& l) { l.speed_max_mm_per_s = -30; },
                               "speed_max_mm_per_s = -30 mm/s: must lie within 0.1 and 500 mm/s"},
                      BadLimit{"Sigma", [](L& l) { l.sigma_target_max_mm = kNan; },
                               "sigma_target_max_mm = nan mm: must lie within 0.001 and 5 mm"},
                      BadLimit{"Inliers", [](L& l) { l.inliers_min = 5; },
                               "inliers_min = 5 inliers: must lie within 6 and 100000 inliers"},
                      BadLimit{"Spread", [](L& l) { l.inlier_spread_min = 15; },
                               "inlier_spread_min = 15 of 1: must lie within 0.01 and 1 of 1"},
                      BadLimit{"Zoom", [](L& l) { l.zoom_tolerance = 0.2; },
                               "zoom_tolerance = 0.2 of zoom: must lie within 0.0001 and 0.1 of"},
                      BadLimit{"Focus", [](L& l) { l.focus_tolerance_mm = 11; },
                               "focus_tolerance_mm = 11 mm: must lie within 0.001 and 10 mm"},
                      BadLimit{"Scale", [](L& l) { l.scale_mismatch_max = 0; },
                               "scale_mismatch_max = 0 of 1: must lie within 0.001 and 0.2 of 1"},
                      BadLimit{"OpticsAge", [](L& l) { l.optics_age_max = milliseconds(0); },
                               "optics_age_max = 0 ms: must lie within 1 and 500 ms"}),
    kCaseName);

INSTANTIATE_TEST_SUITE_P(
    Contradictions, BadLimits,
    ::testing::Values(
        BadLimit{"LatenessBeyondPeriod", [](L& l) { l.frame_lateness = milliseconds(34); },
                 "frame_lateness = 34 ms: must not exceed frame_period = 33.333 ms"},
        BadLimit{"FutureBeyondPeriod",
                 [](L& l) {
                   l.frame_period = milliseconds(10);
                   l.frame_future_max = milliseconds(11);
                 },
                 "frame_future_max = 11 ms: must not exceed frame_period = 10 ms"},
        BadLimit{
            "EstimatesDieBeforeTheNext", [](L& l) { l.estimate_age_max = milliseconds(41); },
            "frame_period + frame_lateness = 41.333 ms: must not exceed estimate_age_max = 41"},
        BadLimit{"LatenessOutlivesPoses",
                 [](L& l) {
                   l.loop_lateness_max = milliseconds(6);
                   l.pose_validity = milliseconds(5);
                 },
                 "loop_lateness_max = 6 ms: must not exceed pose_validity = 5 ms"},
        BadLimit{"RecoveryOnOldImages", [](L& l) { l.hold_recovery = milliseconds(89); },
                 "estimate_age_max = 90 ms: must not exceed hold_recovery = 89 ms"},
        BadLimit{"RecoveryTooLong", [](L& l) { l.hold_max = milliseconds(99); },
                 "hold_recovery = 100 ms: must not exceed hold_max = 99 ms"},
        BadLimit{"ConfirmNever", [](L& l) { l.confirm_max = milliseconds(199); },
                 "confirm_min = 200 ms: must not exceed confirm_max = 199 ms"},
        BadLimit{"DriftBeyondDisplacement", [](L& l) { l.displacement_max_mm = 0.29; },
                 "drift_max_mm = 0.3 mm: must not exceed displacement_max_mm = 0.29 mm"},
        BadLimit{"SigmaBeyondDisplacement",
                 [](L& l) {
                   l.sigma_target_max_mm = 2;
                   l.displacement_max_mm = 1;
                 },
                 "sigma_target_max_mm = 2 mm: must not exceed displacement_max_mm = 1 mm"}),
    kCaseName);

TEST(Limits, DefaultsAreUsable) {
  RecordProperty("requirement", "SR-29");
  EXPECT_EQ(invalid_limit(Limits{}).value_or(""), "");
}

TEST(Limits, AreAcceptedAtTheEndsOfTheirRanges) {
  Limits tight;
  tight.frame_period = milliseconds(1);
  tight.frame_lateness = microseconds(100);
  tight.estimate_age_max = microseconds(1100);
  tight.pose_validity = milliseconds(1);
  tight.robot_silence_max = milliseconds(1);
  tight.loop_lateness_max = microseconds(10);
  tight.clock_step_max = microseconds(1);
  tight.frame_future_max = nanoseconds(0);
  tight.hold_recovery = tight.hold_max = microseconds(1100);
  tight.confirm_min = milliseconds(50);
  tight.confirm_max = milliseconds(100);
  tight.drift_max_mm = tight.sigma_target_max_mm = 0.001;
  tight.displacement_max_mm = 0.01;
  tight.rotation_max_rad = 0.001;
  tight.speed_max_mm_per_s = 0.1;
  tight.inliers_min = 6;
  tight.inlier_spread_min = 0.01;
  tight.zoom_tolerance = 0.0001;
  tight.focus_tolerance_mm = tight.scale_mismatch_max = 0.001;
  tight.optics_age_max = milliseconds(1);
  EXPECT_EQ(invalid_limit(tight).value_or(""), "");
  Limits wide;
  wide.optics_age_max = milliseconds(500);
  wide.zoom_tolerance = 0.1;
  wide.inlier_spread_min = 1;
  EXPECT_EQ(invalid_limit(wide).value_or(""), "");
}

}  // namespace
}  // namespace holdfast::safety
