// SPDX-License-Identifier: Apache-2.0
#include "safety/end_to_end.hpp"

#include <cstdint>
#include <limits>

#include <gtest/gtest.h>

namespace holdfast::safety {
namespace {

using std::chrono::microseconds;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

constexpr std::uint32_t kCrc = 0x1234'5678;
constexpr nanoseconds kStart = milliseconds(10'000);
constexpr nanoseconds kUtcMinusMonotonic = std::chrono::hours(400'000);

/// A message sent at monotonic `t` (and the matching UTC), valid for 15 ms.
Protection message(std::uint32_t counter, nanoseconds t, std::uint32_t source = 7) {
  Protection protection;
  protection.data_id = DataId::compensated_pose;
  protection.source = source;
  protection.counter = counter;
  protection.t_monotonic_ns = t.count();
  protection.t_utc_ns = (t + kUtcMinusMonotonic).count();
  protection.validity_us = 15'000;
  protection.crc32c = kCrc;
  return protection;
}

class ReceiverTest : public ::testing::Test {
 protected:
  Verdict receive(const Protection& protection, nanoseconds now) {
    return receiver.check(protection, kCrc, now, now + kUtcMinusMonotonic);
  }
  /// Receives without delay.
  Verdict receive(const Protection& protection) {
    return receive(protection, nanoseconds(protection.t_monotonic_ns));
  }

  Receiver receiver{DataId::compensated_pose, {}};
};

TEST_F(ReceiverTest, HoldsNothingValidBeforeTheFirstAcceptance) {
  RecordProperty("requirement", "SR-47");
  EXPECT_EQ(receiver.valid_until(), nanoseconds::zero());
  EXPECT_EQ(receiver.source(), 0U);
}

TEST_F(ReceiverTest, HoldsNothingValidAfterRefusalsOnly) {
  RecordProperty("requirement", "SR-40,SR-47");
  Protection corrupt = message(1, kStart);
  corrupt.crc32c ^= 1U;
  EXPECT_EQ(receive(corrupt), Verdict::bad_crc);
  EXPECT_EQ(receiver.valid_until(), nanoseconds::zero());
  EXPECT_EQ(receiver.source(), 0U);
}

TEST_F(ReceiverTest, AcceptsConsecutiveMessages) {
  for (std::uint32_t i = 0; i < 5; ++i) {
    EXPECT_EQ(receive(message(40 + i, kStart + milliseconds(i))), Verdict::accepted);
  }
  EXPECT_EQ(receiver.source(), 7U);
}

TEST_F(ReceiverTest, AcceptsCounterWrap) {
  RecordProperty("requirement", "SR-41");
  EXPECT_EQ(receive(message(0xFFFF'FFFF, kStart)), Verdict::accepted);
  EXPECT_EQ(receive(message(0, kStart + milliseconds(1))), Verdict::accepted);
}

TEST_F(ReceiverTest, RefusesOtherVersion) {
  RecordProperty("requirement", "SR-45");
  Protection other = message(1, kStart);
  other.version = kProtectionVersion + 1;
  EXPECT_EQ(receive(other), Verdict::bad_version);
}

TEST_F(ReceiverTest, RefusesOtherDataId) {
  RecordProperty("requirement", "SR-45");
  Protection other = message(1, kStart);
  other.data_id = DataId::motion_stop;
  EXPECT_EQ(receive(other), Verdict::bad_data_id);
}

TEST_F(ReceiverTest, RefusesSourceZero) {
  RecordProperty("requirement", "SR-45");
  EXPECT_EQ(receive(message(1, kStart, 0)), Verdict::bad_source);
}

TEST_F(ReceiverTest, BelievesNoFieldOfACorruptMessage) {
  RecordProperty("requirement", "SR-40");
  Protection corrupt = message(1, kStart, 0);
  corrupt.data_id = DataId::motion_stop;
  corrupt.crc32c ^= 0x8000'0000U;
  EXPECT_EQ(receive(corrupt), Verdict::bad_crc);
}

TEST_F(ReceiverTest, RefusesRepetition) {
  RecordProperty("requirement", "SR-41");
  ASSERT_EQ(receive(message(5, kStart)), Verdict::accepted);
  EXPECT_EQ(receive(message(5, kStart), kStart + milliseconds(1)), Verdict::repeated);
}

TEST_F(ReceiverTest, RefusesRepetitionWithAFreshStamp) {
  RecordProperty("requirement", "SR-41");
  ASSERT_EQ(receive(message(5, kStart)), Verdict::accepted);
  EXPECT_EQ(receive(message(5, kStart + milliseconds(1))), Verdict::repeated);
}

TEST_F(ReceiverTest, RefusesCounterStepBack) {
  RecordProperty("requirement", "SR-41");
  ASSERT_EQ(receive(message(5, kStart)), Verdict::accepted);
  EXPECT_EQ(receive(message(4, kStart + milliseconds(1))), Verdict::repeated);
  EXPECT_EQ(receive(message(5 + 0x8000'0000U, kStart + milliseconds(1))), Verdict::repeated);
}

TEST_F(ReceiverTest, RefusesSkipOnceAndThenGoesOn) {
  RecordProperty("requirement", "SR-42");
  ASSERT_EQ(receive(message(5, kStart)), Verdict::accepted);
  EXPECT_EQ(receive(message(7, kStart + milliseconds(2))), Verdict::skipped);
  EXPECT_EQ(receive(message(8, kStart + milliseconds(3))), Verdict::accepted);
}

TEST_F(ReceiverTest, SkippedMessageDoesNotProlongValidity) {
  RecordProperty("requirement", "SR-42,SR-47");
  ASSERT_EQ(receive(message(5, kStart)), Verdict::accepted);
  const nanoseconds before = receiver.valid_until();
  ASSERT_EQ(receive(message(7, kStart + milliseconds(2))), Verdict::skipped);
  EXPECT_EQ(receiver.valid_until(), before);
}

TEST_F(ReceiverTest, ToleratesConfiguredLossAndNoMore) {
  RecordProperty("requirement", "SR-42");
  receiver = Receiver(DataId::compensated_pose, {.max_counter_step = 3});
  ASSERT_EQ(receive(message(5, kStart)), Verdict::accepted);
  EXPECT_EQ(receive(message(8, kStart + milliseconds(1))), Verdict::accepted);
  EXPECT_EQ(receive(message(12, kStart + milliseconds(2))), Verdict::skipped);
}

TEST_F(ReceiverTest, AcceptsAgeEqualToValidityWithNothingLeft) {
  const nanoseconds now = kStart + milliseconds(15);
  EXPECT_EQ(receive(message(1, kStart), now), Verdict::accepted);
  EXPECT_EQ(receiver.valid_until(), now);
}

TEST_F(ReceiverTest, RefusesAgeJustBeyondValidity) {
  RecordProperty("requirement", "SR-43");
  EXPECT_EQ(receive(message(1, kStart), kStart + milliseconds(15) + nanoseconds(1)),
            Verdict::expired);
}

TEST_F(ReceiverTest, CutsValidityByAgeAtReception) {
  RecordProperty("requirement", "SR-47");
  const nanoseconds now = kStart + milliseconds(4);
  ASSERT_EQ(receive(message(1, kStart), now), Verdict::accepted);
  EXPECT_EQ(receiver.valid_until(), now + milliseconds(11));
}

TEST_F(ReceiverTest, CutsLongClaimToMaxValidity) {
  RecordProperty("requirement", "SR-47");
  Protection long_lived = message(1, kStart);
  long_lived.validity_us = std::numeric_limits<std::uint32_t>::max();
  ASSERT_EQ(receive(long_lived, kStart + milliseconds(5)), Verdict::accepted);
  EXPECT_EQ(receiver.valid_until(), kStart + milliseconds(20));
}

TEST_F(ReceiverTest, RefusesLongClaimOlderThanMaxValidity) {
  RecordProperty("requirement", "SR-43");
  Protection long_lived = message(1, kStart);
  long_lived.validity_us = std::numeric_limits<std::uint32_t>::max();
  EXPECT_EQ(receive(long_lived, kStart + milliseconds(20) + nanoseconds(1)), Verdict::expired);
}

TEST_F(ReceiverTest, AcceptsZeroValidityOnlyAtItsInstant) {
  Protection instant = message(1, kStart);
  instant.validity_us = 0;
  EXPECT_EQ(receive(instant, kStart + nanoseconds(1)), Verdict::expired);
  EXPECT_EQ(receive(instant, kStart), Verdict::accepted);
  EXPECT_EQ(receiver.valid_until(), kStart);
}

TEST_F(ReceiverTest, AcceptsStampAheadByTheToleranceWithoutLongerValidity) {
  RecordProperty("requirement", "SR-47");
  const nanoseconds now = kStart - milliseconds(1);
  EXPECT_EQ(receive(message(1, kStart), now), Verdict::accepted);
  EXPECT_EQ(receiver.valid_until(), now + milliseconds(15));
}

TEST_F(ReceiverTest, RefusesStampBeyondTheTolerance) {
  RecordProperty("requirement", "SR-44");
  EXPECT_EQ(receive(message(1, kStart), kStart - milliseconds(1) - nanoseconds(1)),
            Verdict::from_future);
}

TEST_F(ReceiverTest, RefusesExtremeStampsWithoutOverflow) {
  Protection extreme = message(1, kStart);
  extreme.t_monotonic_ns = std::numeric_limits<std::int64_t>::min();
  EXPECT_EQ(receive(extreme, kStart), Verdict::expired);
  extreme.t_monotonic_ns = std::numeric_limits<std::int64_t>::max();
  EXPECT_EQ(receive(extreme, kStart), Verdict::from_future);
  EXPECT_EQ(receive(extreme, nanoseconds(-2)), Verdict::expired);
}

TEST_F(ReceiverTest, AClockMayBeginAtZero) {
  EXPECT_EQ(receive(message(1, nanoseconds(0))), Verdict::accepted);
}

TEST_F(ReceiverTest, RefusesTimeReversal) {
  RecordProperty("requirement", "SR-44");
  ASSERT_EQ(receive(message(1, kStart)), Verdict::accepted);
  EXPECT_EQ(receive(message(2, kStart - nanoseconds(1)), kStart + milliseconds(1)),
            Verdict::time_reversed);
}

TEST_F(ReceiverTest, AcceptsEqualStamps) {
  ASSERT_EQ(receive(message(1, kStart)), Verdict::accepted);
  EXPECT_EQ(receive(message(2, kStart)), Verdict::accepted);
}

TEST_F(ReceiverTest, RefusalLeavesTheMemoryAsItWas) {
  ASSERT_EQ(receive(message(1, kStart)), Verdict::accepted);
  const nanoseconds before = receiver.valid_until();
  EXPECT_EQ(receive(message(2, kStart), kStart + milliseconds(16)), Verdict::expired);
  EXPECT_EQ(receive(message(2, kStart + milliseconds(20)), kStart + milliseconds(17)),
            Verdict::from_future);
  EXPECT_EQ(receive(message(2, kStart - milliseconds(1)), kStart), Verdict::time_reversed);
  EXPECT_EQ(receive(message(2, kStart, 8), kStart), Verdict::bad_source);
  EXPECT_EQ(receiver.valid_until(), before);
  EXPECT_EQ(receive(message(2, kStart + milliseconds(18))), Verdict::accepted);
}

TEST_F(ReceiverTest, ExpiredMessageWithASkippedCounterDoesNotResynchronise) {
  ASSERT_EQ(receive(message(1, kStart)), Verdict::accepted);
  EXPECT_EQ(receive(message(3, kStart), kStart + milliseconds(16)), Verdict::expired);
  EXPECT_EQ(receive(message(4, kStart + milliseconds(17))), Verdict::skipped);
}

TEST_F(ReceiverTest, RefusesSecondSourceWhileTheFirstIsAlive) {
  RecordProperty("requirement", "SR-46");
  ASSERT_EQ(receive(message(1, kStart, 7)), Verdict::accepted);
  const nanoseconds later = kStart + milliseconds(100) - nanoseconds(1);
  EXPECT_EQ(receive(message(1, later, 8)), Verdict::bad_source);
  EXPECT_EQ(receiver.source(), 7U);
}

TEST_F(ReceiverTest, AcceptsSecondSourceAfterTheTimeout) {
  RecordProperty("requirement", "SR-46");
  ASSERT_EQ(receive(message(900, kStart, 7)), Verdict::accepted);
  EXPECT_EQ(receive(message(3, kStart + milliseconds(100), 8)), Verdict::accepted);
  EXPECT_EQ(receiver.source(), 8U);
  EXPECT_EQ(receive(message(901, kStart + milliseconds(101), 7)), Verdict::bad_source);
}

TEST_F(ReceiverTest, ASkippingSourceIsAlive) {
  RecordProperty("requirement", "SR-46");
  ASSERT_EQ(receive(message(1, kStart, 7)), Verdict::accepted);
  ASSERT_EQ(receive(message(9, kStart + milliseconds(60), 7)), Verdict::skipped);
  EXPECT_EQ(receive(message(1, kStart + milliseconds(120), 8)), Verdict::bad_source);
}

TEST_F(ReceiverTest, TakeoverMustItselfBeFresh) {
  ASSERT_EQ(receive(message(1, kStart, 7)), Verdict::accepted);
  EXPECT_EQ(receive(message(1, kStart, 8), kStart + milliseconds(200)), Verdict::expired);
  EXPECT_EQ(receiver.source(), 7U);
}

TEST_F(ReceiverTest, OnOneHostIgnoresUtc) {
  Protection wrong_utc = message(1, kStart);
  wrong_utc.t_utc_ns = 0;
  EXPECT_EQ(receive(wrong_utc, kStart), Verdict::accepted);
}

class UtcReceiverTest : public ReceiverTest {
 protected:
  void SetUp() override {
    receiver = Receiver(DataId::compensated_pose, {.clock = ClockRelation::synchronised_utc});
  }
  /// The sender's monotonic clock has nothing to do with ours.
  static Protection remote(std::uint32_t counter, nanoseconds t) {
    Protection protection = message(counter, t);
    protection.t_monotonic_ns = 5 + counter;
    return protection;
  }
};

TEST_F(UtcReceiverTest, TakesAgeFromUtcAndValidityOnOwnMonotonic) {
  const nanoseconds now = kStart + milliseconds(6);
  ASSERT_EQ(receive(remote(1, kStart), now), Verdict::accepted);
  EXPECT_EQ(receiver.valid_until(), now + milliseconds(9));
}

TEST_F(UtcReceiverTest, RefusesExpiryOnUtc) {
  RecordProperty("requirement", "SR-43");
  EXPECT_EQ(receive(remote(1, kStart), kStart + milliseconds(15)), Verdict::accepted);
  EXPECT_EQ(receive(remote(2, kStart), kStart + milliseconds(15) + nanoseconds(1)),
            Verdict::expired);
}

TEST_F(UtcReceiverTest, RefusesFutureOnUtc) {
  RecordProperty("requirement", "SR-44");
  EXPECT_EQ(receive(remote(1, kStart), kStart - milliseconds(1) - nanoseconds(1)),
            Verdict::from_future);
}

TEST_F(UtcReceiverTest, RefusesReversalOfUtc) {
  RecordProperty("requirement", "SR-44");
  ASSERT_EQ(receive(remote(1, kStart), kStart), Verdict::accepted);
  EXPECT_EQ(receive(remote(2, kStart - nanoseconds(1)), kStart), Verdict::time_reversed);
}

TEST(VerdictName, IsTheEnumeratorsOwn) {
  EXPECT_EQ(name(Verdict::accepted), "accepted");
  EXPECT_EQ(name(Verdict::bad_version), "bad_version");
  EXPECT_EQ(name(Verdict::bad_data_id), "bad_data_id");
  EXPECT_EQ(name(Verdict::bad_source), "bad_source");
  EXPECT_EQ(name(Verdict::bad_crc), "bad_crc");
  EXPECT_EQ(name(Verdict::repeated), "repeated");
  EXPECT_EQ(name(Verdict::skipped), "skipped");
  EXPECT_EQ(name(Verdict::expired), "expired");
  EXPECT_EQ(name(Verdict::from_future), "from_future");
  EXPECT_EQ(name(Verdict::time_reversed), "time_reversed");
  EXPECT_EQ(name(static_cast<Verdict>(200)), "unknown");
}

}  // namespace
}  // namespace holdfast::safety
