// SPDX-License-Identifier: Apache-2.0
// Messages that fail the end-to-end check withdraw the client's permission, in whatever order.
#include <functional>
#include <ostream>
#include <random>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "tests/bridge/permission_core_fixture.hpp"

namespace holdfast::client {
namespace {

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

}  // namespace
}  // namespace holdfast::client
