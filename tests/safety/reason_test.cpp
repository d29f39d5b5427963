// SPDX-License-Identifier: Apache-2.0
#include "safety/reason.hpp"

#include <set>
#include <string>

#include <gtest/gtest.h>

namespace holdfast::safety {
namespace {

TEST(Reason, HasItsSeverityByRange) {
  EXPECT_EQ(severity(Reason::none), Severity::none);
  for (int code = 1; code < 256; ++code) {
    const Severity expected = code <= 20   ? Severity::stop
                              : code <= 44 ? Severity::hold
                              : code <= 55 ? Severity::readiness
                              : code <= 63 ? Severity::advisory
                                           : Severity::stop;  // cannot be: the worst is assumed
    EXPECT_EQ(severity(static_cast<Reason>(code)), expected) << code;
  }
}

TEST(Reason, KeepsItsCodeAndNameOnTheWire) {
  const auto names = [](int first, int last) {
    std::string text;
    for (int code = first; code <= last; ++code) {
      text += std::string(name(static_cast<Reason>(code))) + ' ';
    }
    return text;
  };
  EXPECT_EQ(names(0, 17),
            "none operator_stop invalid_number clock_step loop_overrun second_publisher "
            "registration_changed optics_changed robot_fault drift_exceeded displacement_exceeded "
            "speed_exceeded pose_jump message_corrupt hold_timeout internal_fault "
            "scale_mismatch unknown ");
  EXPECT_EQ(names(20, 44),
            "unknown camera_disconnected frame_late frame_incomplete frame_gap frame_frozen "
            "frame_dark frame_saturated frame_time_invalid tracking_lost tracking_degraded "
            "tracking_weak estimate_stale covariance_exceeded robot_silent microscope_missing "
            "microscope_not_operational microscope_silent microscope_corrupt can_bus_off "
            "can_error_passive can_overflow can_down optics_moving unknown ");
  EXPECT_EQ(names(44, 50),
            "unknown initialising not_registered keyframe_unverified not_armed "
            "awaiting_acknowledgement unknown ");
  EXPECT_EQ(names(55, 61),
            "unknown not_real_time unsecured_transport not_recording optics_unwatched "
            "virtual_microscope unknown ");
}

TEST(ReasonSet, IsEmptyFromTheStart) {
  EXPECT_TRUE(ReasonSet{}.empty());
  EXPECT_EQ(ReasonSet{}.primary(), Reason::none);
}

TEST(ReasonSet, NamesTheLowestCodeAsPrimary) {
  RecordProperty("requirement", "SR-27");
  ReasonSet reasons;
  reasons.insert(Reason::unsecured_transport);
  EXPECT_EQ(reasons.primary(), Reason::unsecured_transport);
  reasons.insert(Reason::robot_silent);
  EXPECT_EQ(reasons.primary(), Reason::robot_silent);
  reasons.insert(Reason::operator_stop);
  EXPECT_EQ(reasons.primary(), Reason::operator_stop);
}

TEST(ReasonSet, SplitsBySeverityWithoutRemainder) {
  const ReasonSet all(~std::uint64_t{0});
  ReasonSet sum;
  for (const Severity severity :
       {Severity::stop, Severity::hold, Severity::readiness, Severity::advisory}) {
    const ReasonSet part = all.with(severity);
    EXPECT_EQ(part.bits() & sum.bits(), 0U);
    for (int code = 1; code < 64; ++code) {
      const auto reason = static_cast<Reason>(code);
      EXPECT_EQ(part.contains(reason), holdfast::safety::severity(reason) == severity) << code;
    }
    sum.insert(part);
  }
  EXPECT_EQ(sum, all);
  EXPECT_TRUE(all.with(Severity::none).empty());
}

TEST(ReasonSet, TreatsAnUnknownSeverityAsEverything) {
  const ReasonSet all(~std::uint64_t{0});
  EXPECT_EQ(all.with(static_cast<Severity>(9)), all);
}

TEST(ReasonSet, DropsWhatIsNoReason) {
  EXPECT_TRUE(ReasonSet(1).empty());
  ReasonSet reasons;
  reasons.insert(Reason::none);
  reasons.insert(static_cast<Reason>(200));
  EXPECT_TRUE(reasons.empty());
  EXPECT_FALSE(reasons.contains(static_cast<Reason>(200)));
}

TEST(ReasonSet, ErasesOneReason) {
  ReasonSet reasons;
  reasons.insert(Reason::frame_dark);
  reasons.insert(Reason::frame_gap);
  reasons.erase(Reason::frame_gap);
  EXPECT_EQ(reasons.bits(), std::uint64_t{1} << 26U);
}

}  // namespace
}  // namespace holdfast::safety
