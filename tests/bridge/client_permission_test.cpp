// SPDX-License-Identifier: Apache-2.0
// When the client permits, and for how long: streams, silence, senders, clocks.
#include <gtest/gtest.h>

#include "tests/bridge/permission_core_fixture.hpp"

namespace holdfast::client {
namespace {

TEST_F(PermissionCoreTest, RefusesBeforeAnyMessage) {
  RecordProperty("requirement", "SR-50");
  const auto p = core.decide(kT0);
  EXPECT_FALSE(p.is_permitted());
  EXPECT_EQ(p.refusal, Refusal::no_stop_message);
}

TEST_F(PermissionCoreTest, RefusesPosesAlone) {
  RecordProperty("requirement", "SR-50");
  for (int i = 0; i < 10; ++i) core.take(daemon.pose(kT0 + i * 1ms), at(kT0 + i * 1ms));
  EXPECT_EQ(core.decide(kT0 + 9ms).refusal, Refusal::no_stop_message);
}

TEST_F(PermissionCoreTest, RefusesPermissionAlone) {
  RecordProperty("requirement", "SR-50");
  for (int i = 0; i < 10; ++i) core.take(daemon.permitted(kT0 + i * 1ms), at(kT0 + i * 1ms));
  EXPECT_EQ(core.decide(kT0 + 9ms).refusal, Refusal::no_pose);
}

TEST_F(PermissionCoreTest, PermitsOnceBothStreamsAreConsistent) {
  core.take(daemon.permitted(kT0), at(kT0));
  core.take(daemon.pose(kT0), at(kT0));
  EXPECT_EQ(core.decide(kT0).refusal, Refusal::no_stop_message);
  core.take(daemon.permitted(kT0 + 1ms), at(kT0 + 1ms));
  EXPECT_EQ(core.decide(kT0 + 1ms).refusal, Refusal::no_pose);
  core.take(daemon.pose(kT0 + 1ms), at(kT0 + 1ms));
  const auto p = core.decide(kT0 + 1ms);
  ASSERT_TRUE(p.is_permitted());
  EXPECT_EQ(p.refusal, Refusal::none);
  EXPECT_EQ(p.pose->counter, 2U);
  EXPECT_EQ(p.pose->translation_mm[2], 200);
  EXPECT_EQ(p.pose->rotation_xyzw[3], 1);
  EXPECT_EQ(p.pose->frame, 5U);
  EXPECT_EQ(p.pose->t_valid_until_ns, nanoseconds(kT0 + 16ms).count());
}

TEST_F(PermissionCoreTest, PoseExpiresWithItsValidity) {
  RecordProperty("requirement", "SR-51");
  permit(kT0);
  EXPECT_TRUE(core.decide(kT0 + 15ms).is_permitted());
  EXPECT_EQ(core.decide(kT0 + 15ms + 1ns).refusal, Refusal::pose_silent);
}

TEST_F(PermissionCoreTest, PermissionExpiresWhenStopMessagesEnd) {
  RecordProperty("requirement", "SR-51");
  permit(kT0);
  for (int i = 1; i <= 21; ++i) core.take(daemon.pose(kT0 + i * 1ms), at(kT0 + i * 1ms));
  EXPECT_TRUE(core.decide(kT0 + 20ms).is_permitted());
  EXPECT_EQ(core.decide(kT0 + 20ms).pose->t_valid_until_ns, nanoseconds(kT0 + 20ms).count());
  EXPECT_EQ(core.decide(kT0 + 20ms + 1ns).refusal, Refusal::stop_silent);
}

TEST_F(PermissionCoreTest, CutsALongClaimOfValidity) {
  RecordProperty("requirement", "SR-51");
  permit(kT0);
  auto pose = daemon.pose(kT0 + 1ms);
  pose.protection.validity_us = 10'000'000;
  core.take(resealed(pose), at(kT0 + 1ms));
  auto stop = daemon.permitted(kT0 + 1ms);
  stop.protection.validity_us = 10'000'000;
  core.take(resealed(stop), at(kT0 + 1ms));
  EXPECT_TRUE(core.decide(kT0 + 21ms).is_permitted());
  EXPECT_FALSE(core.decide(kT0 + 21ms + 1ns).is_permitted());
}

TEST_F(PermissionCoreTest, ADelayedPoseIsValidNoLonger) {
  RecordProperty("requirement", "SR-51");
  permit(kT0);
  core.take(daemon.pose(kT0 + 1ms), at(kT0 + 11ms));
  EXPECT_TRUE(core.decide(kT0 + 16ms).is_permitted());
  EXPECT_FALSE(core.decide(kT0 + 16ms + 1ns).is_permitted());
}

TEST_F(PermissionCoreTest, AnOldPredictionInAFreshMessageExpiresEarlier) {
  RecordProperty("requirement", "SR-51");
  permit(kT0);
  auto pose = daemon.pose(kT0 + 10ms);
  pose.t_pose_ns = nanoseconds(kT0 + 2ms).count();
  core.take(resealed(pose), at(kT0 + 10ms));
  EXPECT_TRUE(core.decide(kT0 + 17ms).is_permitted());
  EXPECT_EQ(core.decide(kT0 + 17ms + 1ns).refusal, Refusal::pose_silent);
}

TEST_F(PermissionCoreTest, StopEndsPermissionAtOnce) {
  RecordProperty("requirement", "SR-53");
  permit(kT0);
  core.take(daemon.stopped(kT0), at(kT0));
  const auto p = core.decide(kT0);
  EXPECT_EQ(p.refusal, Refusal::not_permitted);
  EXPECT_TRUE(p.stop.is_latched);
  EXPECT_EQ(p.stop.cause, 9);
  EXPECT_EQ(p.stop.stop_id, 3U);
}

TEST_F(PermissionCoreTest, ThePoseFromBeforeAStopIsNotUsedAfterIt) {
  RecordProperty("requirement", "SR-53");
  permit(kT0);
  core.take(daemon.stopped(kT0 + 1ms), at(kT0 + 1ms));
  daemon.t_permitted = kT0 + 2ms;
  core.take(daemon.permitted(kT0 + 2ms), at(kT0 + 2ms));
  EXPECT_EQ(core.decide(kT0 + 2ms).refusal, Refusal::pose_before_permission);
  core.take(daemon.pose(kT0 + 2ms), at(kT0 + 2ms));
  EXPECT_TRUE(core.decide(kT0 + 2ms).is_permitted());
}

TEST_F(PermissionCoreTest, SecondSourceIsHeldAfterItsLastMessage) {
  permit(kT0);
  Daemon other{.source = kSource + 1};
  core.take(other.pose(kT0), at(kT0));
  nanoseconds t = kT0;
  while (t < kT0 + 999ms) {
    t += 1ms;
    core.take(daemon.permitted(t), at(t));
    core.take(daemon.pose(t), at(t));
    ASSERT_EQ(core.decide(t).refusal, Refusal::second_source);
  }
  EXPECT_EQ(messages_to_recover(kT0 + 1000ms), 1);
}

TEST_F(PermissionCoreTest, ANewDaemonIsBelievedAfterTheOldOneFellSilent) {
  permit(kT0);
  Daemon restarted{.source = kSource + 1};
  const nanoseconds t = kT0 + 150ms;
  core.take(restarted.permitted(t), at(t));
  core.take(restarted.pose(t), at(t));
  EXPECT_FALSE(core.decide(t).is_permitted());
  core.take(restarted.permitted(t + 1ms), at(t + 1ms));
  core.take(restarted.pose(t + 1ms), at(t + 1ms));
  EXPECT_TRUE(core.decide(t + 1ms).is_permitted());
}

TEST_F(PermissionCoreTest, PosesOfAnotherSourceThanTheStopsAreRefused) {
  Daemon other{.source = kSource + 1};
  for (const nanoseconds t : {kT0, kT0 + 1ms}) {
    core.take(daemon.permitted(t), at(t));
    core.take(other.pose(t), at(t));
  }
  EXPECT_EQ(core.decide(kT0 + 1ms).refusal, Refusal::sources_differ);
}

// Another host: its CLOCK_MONOTONIC started elsewhere, UTC is common.
class SynchronisedHostTest : public PermissionCoreTest {
 public:
  static constexpr nanoseconds kOurStart = 5000s;
  static Clocks ours(nanoseconds t) { return {.monotonic = t + kOurStart, .utc = t + kUtcOffset}; }
  void SetUp() override {
    parameters.clock = ClockRelation::synchronised_utc;
    core = PermissionCore(parameters);
    for (const nanoseconds t : {kT0 - 1ms, kT0}) {
      core.take(daemon.permitted(t), ours(t));
      core.take(daemon.pose(t), ours(t));
    }
  }
};

TEST_F(SynchronisedHostTest, TimesAreOnOurClock) {
  const auto p = core.decide(kT0 + kOurStart);
  ASSERT_TRUE(p.is_permitted());
  EXPECT_EQ(p.pose->t_pose_ns, nanoseconds(kT0 + kOurStart).count());
  EXPECT_EQ(p.pose->t_valid_until_ns, nanoseconds(kT0 + kOurStart + 15ms).count());
}

TEST_F(SynchronisedHostTest, ExpiresOnOurClock) {
  RecordProperty("requirement", "SR-51");
  EXPECT_TRUE(core.decide(kT0 + kOurStart + 15ms).is_permitted());
  EXPECT_FALSE(core.decide(kT0 + kOurStart + 15ms + 1ns).is_permitted());
}

TEST_F(SynchronisedHostTest, RefusesWhatIsOldByUtc) {
  RecordProperty("requirement", "SR-52");
  core.take(daemon.pose(kT0 + 1ms), ours(kT0 + 30ms));
  EXPECT_EQ(core.newest_refusal(), Refusal::expired);
}

TEST(Refusal, EachCodeHasItsName) {
  int named = 0;
  for (std::uint8_t code = 0; code < kRefusalCodes; ++code)
    named += name(static_cast<Refusal>(code)) != "unknown" ? 1 : 0;
  EXPECT_EQ(named, 26);
  EXPECT_EQ(name(Refusal::contradictory_stop), "contradictory_stop");
  EXPECT_EQ(name(static_cast<Refusal>(200)), "unknown");
}

}  // namespace
}  // namespace holdfast::client
