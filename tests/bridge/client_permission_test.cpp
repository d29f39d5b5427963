// SPDX-License-Identifier: Apache-2.0
// The client's decision without DDS: a scripted daemon, time passed in.
#include <cmath>
#include <functional>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "bridge/client/permission.hpp"

namespace holdfast::client {
namespace {

using bridge::dds::canonical_crc;
using bridge::dds::protect;
using std::chrono::nanoseconds;
using namespace std::chrono_literals;

constexpr nanoseconds kUtcOffset = 1'700'000'000s;
constexpr std::uint32_t kSource = 7;

Clocks at(nanoseconds monotonic) {
  return {.monotonic = monotonic, .utc = monotonic + kUtcOffset};
}

// The daemon's side of both streams.
struct Daemon {
  std::uint32_t source = kSource;
  std::uint32_t pose_counter = 0, stop_counter = 0;
  nanoseconds t_permitted{};

  msg::CompensatedPose pose(nanoseconds t) {
    msg::CompensatedPose m{};
    m.t_pose_ns = t.count();
    m.t_exposure_ns = (t - 20ms).count();
    m.t_frame_received_ns = (t - 15ms).count();
    m.frame = 5;
    m.registration_id = 9;
    m.translation_mm[2] = 200;
    m.rotation_xyzw[3] = 1;
    for (std::size_t i = 0; i < 6; ++i) m.covariance[7 * i] = 0.01;
    protect(m, source, ++pose_counter, 15ms, at(t));
    return m;
  }
  msg::MotionStop permitted(nanoseconds t) {
    msg::MotionStop m{};
    m.mode = 3;
    m.is_permitted = true;
    m.t_changed_ns = t_permitted.count();
    protect(m, source, ++stop_counter, 20ms, at(t));
    return m;
  }
  msg::MotionStop stopped(nanoseconds t) {
    msg::MotionStop m{};
    m.mode = 5;
    m.cause = 9;
    m.is_latched = true;
    m.stop_id = 3;
    m.t_changed_ns = t.count();
    protect(m, source, ++stop_counter, 20ms, at(t));
    return m;
  }
};

template <class M>
M resealed(M message) {
  message.protection.crc32c = canonical_crc(message);
  return message;
}

class PermissionCoreTest : public testing::Test {
 public:
  // Two good messages on each stream, the last ones sent and received at `t`.
  void permit(nanoseconds t) {
    for (const nanoseconds sent : {t - 1ms, t}) {
      core.take(daemon.permitted(sent), at(sent));
      core.take(daemon.pose(sent), at(sent));
    }
    ASSERT_EQ(core.decide(t).refusal, Refusal::none);
  }
  // Good messages on both streams at t, t + 1 ms, ... until permission is back; how many it took.
  int messages_to_recover(nanoseconds t) {
    for (int n = 1; n <= 10; ++n, t += 1ms) {
      core.take(daemon.permitted(t), at(t));
      core.take(daemon.pose(t), at(t));
      if (core.decide(t).is_permitted()) return n;
    }
    return -1;
  }

  // The guard's part has its own tests: client_guard_test.cpp.
  static Parameters without_guard() {
    Parameters result;
    result.guard = Guard::absent;
    return result;
  }
  Parameters parameters = without_guard();
  PermissionCore core{parameters};
  Daemon daemon;
  static constexpr nanoseconds kT0 = 100s;
};

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

// Every way in which a message can be bad, on both streams.
struct BadMessage {
  const char* name;
  Refusal refusal;
  std::function<void(msg::Protection&)> spoil;
  bool reseal = true;
};
void PrintTo(const BadMessage& bad, std::ostream* os) {
  *os << bad.name;
}
std::vector<BadMessage> bad_messages() {
  using P = msg::Protection;
  const auto shift = [](P& p, nanoseconds by) {
    p.t_monotonic_ns += by.count();
    p.t_utc_ns += by.count();
  };
  return {
      {"BadCrc", Refusal::bad_crc, [](P& p) { p.crc32c ^= 1; }, false},
      {"BadVersion", Refusal::bad_version, [](P& p) { ++p.version; }},
      {"BadDataId", Refusal::bad_data_id, [](P& p) { p.data_id = 6; }},
      {"NoSource", Refusal::no_source, [](P& p) { p.source = 0; }},
      {"SecondSource", Refusal::second_source, [](P& p) { p.source = kSource + 1; }},
      {"Repeated", Refusal::repeated, [](P& p) { --p.counter; }},
      {"SteppedBack", Refusal::repeated, [](P& p) { p.counter -= 2; }},
      {"Skipped", Refusal::skipped, [](P& p) { ++p.counter; }},
      {"Expired", Refusal::expired, [=](P& p) { shift(p, -21ms); }},
      {"FromFuture", Refusal::from_future, [=](P& p) { shift(p, 1ms + 1ns); }},
      {"TimeReversed", Refusal::time_reversed, [=](P& p) { shift(p, -3ms); }},
  };
}

class BadMessageTest : public PermissionCoreTest, public testing::WithParamInterface<BadMessage> {
 public:
  template <class M>
  M spoiled(M message) {
    GetParam().spoil(message.protection);
    return GetParam().reseal ? resealed(message) : message;
  }
  // The daemon goes on counting from what it last sent.
  void expect_refused_and_recovered(std::uint64_t refused) {
    const auto p = core.decide(kT0 + 2ms);
    EXPECT_FALSE(p.is_permitted());
    EXPECT_EQ(p.refusal, GetParam().refusal);
    EXPECT_EQ(core.newest_refusal(), GetParam().refusal);
    EXPECT_EQ(refused, 1U);
    EXPECT_EQ(core.counts().refused_messages[static_cast<std::size_t>(GetParam().refusal)], 1U);
    if (GetParam().refusal == Refusal::second_source) {
      EXPECT_EQ(messages_to_recover(kT0 + 3ms), -1);  // held, see SecondSourceIsHeld
      return;
    }
    EXPECT_EQ(messages_to_recover(kT0 + 3ms), parameters.recovery_messages);
  }
};

TEST_P(BadMessageTest, AmongPosesWithdrawsPermission) {
  RecordProperty("requirement", "SR-52");
  permit(kT0);
  core.take(daemon.permitted(kT0 + 2ms), at(kT0 + 2ms));
  const auto good = daemon.pose(kT0 + 2ms);
  core.take(spoiled(good), at(kT0 + 2ms));
  if (GetParam().refusal == Refusal::skipped)
    ++daemon.pose_counter;  // the one between was lost
  else
    --daemon.pose_counter;  // as if the bad one had been put in by someone else
  expect_refused_and_recovered(core.counts().poses_refused);
}

TEST_P(BadMessageTest, AmongStopMessagesWithdrawsPermission) {
  RecordProperty("requirement", "SR-52");
  permit(kT0);
  core.take(daemon.pose(kT0 + 2ms), at(kT0 + 2ms));
  const auto good = daemon.permitted(kT0 + 2ms);
  core.take(spoiled(good), at(kT0 + 2ms));
  if (GetParam().refusal == Refusal::skipped)
    ++daemon.stop_counter;
  else
    --daemon.stop_counter;
  expect_refused_and_recovered(core.counts().stops_refused);
}

INSTANTIATE_TEST_SUITE_P(PermissionCore, BadMessageTest, testing::ValuesIn(bad_messages()),
                         [](const auto& test) { return std::string(test.param.name); });

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

TEST_F(PermissionCoreTest, RefusesEveryNumberThatIsNotFinite) {
  RecordProperty("requirement", "SR-54");
  int fields = 0;
  for (const double bad :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity(),
        -std::numeric_limits<double>::infinity()}) {
    const auto count_doubles = [] {
      msg::CompensatedPose m{};
      int n = 0;
      msg::for_each_field(m, [&n](auto& f) {
        if constexpr (std::is_same_v<std::remove_reference_t<decltype(f)>, double>) ++n;
      });
      return n;
    };
    for (int chosen = 0; chosen < count_doubles(); ++chosen, ++fields) {
      core = PermissionCore(parameters);
      daemon = Daemon{};
      permit(kT0);
      auto pose = daemon.pose(kT0);
      int n = 0;
      msg::for_each_field(pose, [&](auto& f) {
        if constexpr (std::is_same_v<std::remove_reference_t<decltype(f)>, double>)
          if (n++ == chosen) f = bad;
      });
      core.take(resealed(pose), at(kT0));
      EXPECT_EQ(core.decide(kT0).refusal, Refusal::invalid_number) << chosen;
    }
  }
  EXPECT_EQ(fields, 3 * (3 + 4 + 36 + 3));
}

struct BadContent {
  const char* name;
  Refusal refusal;
  std::function<void(msg::CompensatedPose&)> spoil;
};
void PrintTo(const BadContent& bad, std::ostream* os) {
  *os << bad.name;
}
class BadContentTest : public PermissionCoreTest, public testing::WithParamInterface<BadContent> {};

TEST_P(BadContentTest, IsRefused) {
  RecordProperty("requirement", "SR-54");
  permit(kT0);
  auto pose = daemon.pose(kT0 + 1ms);
  GetParam().spoil(pose);
  core.take(resealed(pose), at(kT0 + 1ms));
  EXPECT_EQ(core.decide(kT0 + 1ms).refusal, GetParam().refusal);
  EXPECT_EQ(core.counts().poses_refused, 1U);
}

INSTANTIATE_TEST_SUITE_P(
    PermissionCore, BadContentTest,
    testing::Values(
        BadContent{"ZeroQuaternion", Refusal::invalid_rotation,
                   [](auto& m) { m.rotation_xyzw[3] = 0; }},
        BadContent{"LongQuaternion", Refusal::invalid_rotation,
                   [](auto& m) { m.rotation_xyzw[3] = 1 + 2e-6; }},
        BadContent{"ShortQuaternion", Refusal::invalid_rotation,
                   [](auto& m) { m.rotation_xyzw[3] = 1 - 2e-6; }},
        BadContent{"ZeroVariance", Refusal::invalid_covariance,
                   [](auto& m) { m.covariance[14] = 0; }},
        BadContent{"NegativeVariance", Refusal::invalid_covariance,
                   [](auto& m) { m.covariance[35] = -0.01; }},
        BadContent{"Asymmetry", Refusal::invalid_covariance,
                   [](auto& m) { m.covariance[1] = 1e-6; }},
        BadContent{"PoseFarAhead", Refusal::invalid_time,
                   [](auto& m) { m.t_pose_ns += nanoseconds(20ms + 1ns).count(); }},
        BadContent{"PoseFarBehind", Refusal::invalid_time,
                   [](auto& m) { m.t_pose_ns -= nanoseconds(20ms + 1ns).count(); }},
        BadContent{
            "StaleImage", Refusal::invalid_time,
            [](auto& m) { m.t_exposure_ns = m.t_pose_ns - nanoseconds(120ms + 1ns).count(); }},
        BadContent{"ImageFromTheFuture", Refusal::invalid_time,
                   [](auto& m) { m.t_exposure_ns = m.protection.t_monotonic_ns + 1; }},
        BadContent{"ArrivalInTheFuture", Refusal::invalid_time,
                   [](auto& m) { m.t_frame_received_ns = m.protection.t_monotonic_ns + 1; }},
        BadContent{"TimeBeforeTheEpoch", Refusal::invalid_time,
                   [](auto& m) { m.t_pose_ns = std::numeric_limits<std::int64_t>::min(); }}),
    [](const auto& test) { return std::string(test.param.name); });

TEST_F(PermissionCoreTest, AcceptsContentAtItsLimits) {
  permit(kT0);
  auto pose = daemon.pose(kT0 + 1ms);
  pose.t_exposure_ns = pose.t_pose_ns - nanoseconds(120ms).count();
  pose.rotation_xyzw[3] = 1 + 0.9e-6;
  core.take(resealed(pose), at(kT0 + 1ms));
  EXPECT_TRUE(core.decide(kT0 + 1ms).is_permitted());
}

TEST_F(PermissionCoreTest, RefusesAContradictoryStopMessage) {
  RecordProperty("requirement", "SR-52");
  using Spoil = std::function<void(msg::MotionStop&)>;
  for (const Spoil& spoil :
       {Spoil([](auto& m) { m.mode = 4; }), Spoil([](auto& m) { m.cause = 2; }),
        Spoil([](auto& m) { m.is_latched = true; }),
        Spoil([](auto& m) { m.is_permitted = false; })}) {
    core = PermissionCore(parameters);
    daemon = Daemon{};
    permit(kT0);
    auto stop = daemon.permitted(kT0);
    spoil(stop);
    core.take(resealed(stop), at(kT0));
    EXPECT_EQ(core.decide(kT0).refusal, Refusal::contradictory_stop);
  }
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

// Whatever happens to the messages: permission only on what was good, fresh, permitted and whole.
TEST_F(PermissionCoreTest, NoSequenceOfFaultsYieldsAFalsePermission) {
  RecordProperty("requirement", "SR-51,SR-52,SR-53");
  std::mt19937_64 random(1);
  const auto chance = [&](double p) { return std::bernoulli_distribution(p)(random); };
  // Those that are bad whatever came before. Losses make the skips; one that follows a loss may
  // turn a repetition into the message that was due.
  auto faults = bad_messages();
  std::erase_if(faults, [](const BadMessage& bad) {
    return bad.refusal == Refusal::repeated || bad.refusal == Refusal::skipped ||
           bad.refusal == Refusal::time_reversed || bad.refusal == Refusal::second_source;
  });
  nanoseconds t = kT0, t_last_good_pose{}, t_last_good_stop{};
  bool says_permitted = false;
  long permitted = 0, refused = 0;
  for (int i = 0; i < 200'000; ++i) {
    t += nanoseconds(std::uniform_int_distribution<std::int64_t>(1, 2'000'000)(random));
    if (chance(0.02)) t += 30ms;  // silence
    const auto& fault = faults[random() % faults.size()];
    bool has_bad = false;
    const auto deliver = [&](auto message) {
      if (chance(0.02)) return false;  // lost
      has_bad = chance(0.02);
      if (has_bad) fault.spoil(message.protection);
      core.take(has_bad && fault.reseal ? resealed(message) : message, at(t));
      return !has_bad;
    };
    if (chance(0.7) && deliver(daemon.pose(t))) t_last_good_pose = t;
    if (chance(0.5)) {
      const bool permits = chance(0.9);
      if (deliver(permits ? daemon.permitted(t) : daemon.stopped(t))) {
        t_last_good_stop = t;
        says_permitted = permits;
      }
    }
    const nanoseconds now = t + nanoseconds(std::uniform_int_distribution<int>(0, 500'000)(random));
    if (!core.decide(now).is_permitted()) {
      ++refused;
      continue;
    }
    ++permitted;
    ASSERT_FALSE(has_bad);
    ASSERT_TRUE(says_permitted);
    ASSERT_LE(now - t_last_good_pose, 15ms);
    ASSERT_LE(now - t_last_good_stop, 20ms);
  }
  EXPECT_GT(permitted, 1000);
  EXPECT_GT(refused, 1000);
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
