// SPDX-License-Identifier: Apache-2.0
#include "rt/core/stop_latch.hpp"

#include <cstdint>
#include <thread>

#include <gtest/gtest.h>

#include "rt/core/mailbox.hpp"

namespace holdfast::rt {
namespace {

TEST(StopLatch, IsEmptyAtFirst) {
  StopLatch latch;
  EXPECT_FALSE(latch.take());
}

TEST(StopLatch, GivesARaiseOnce) {
  StopLatch latch;
  latch.raise(0b1000, 17);
  const auto stop = latch.take();
  ASSERT_TRUE(stop);
  EXPECT_EQ(stop->reasons, 0b1000U);
  EXPECT_EQ(stop->sequence, 17U);
  EXPECT_FALSE(latch.take());
}

TEST(StopLatch, CollectsTheReasonsOfAllRaisesSinceTheLastTake) {
  StopLatch latch;
  latch.raise(0b0010, 1);
  latch.raise(0b0100, 2);
  const auto stop = latch.take();
  ASSERT_TRUE(stop);
  EXPECT_EQ(stop->reasons, 0b0110U);
  EXPECT_EQ(stop->sequence, 2U);
}

TEST(StopLatch, KeepsARaiseWithoutReasons) {
  StopLatch latch;
  latch.raise(0, 3);
  const auto stop = latch.take();
  ASSERT_TRUE(stop);
  EXPECT_EQ(stop->reasons, 0U);
  EXPECT_EQ(stop->sequence, 3U);
}

// The deciding thread withdraws permission in single cycles and permits in the next, as fast as it
// can; the publishing thread, which the mailbox lets see only some cycles, must learn of each stop
// before it uses a later cycle's permission.
TEST(StopLatch, NoStopIsLostBehindALaterPermission) {
  constexpr std::uint64_t kCycles = 200'000;
  constexpr std::uint64_t kStopEvery = 7;
  Mailbox<std::uint64_t> mailbox;
  StopLatch latch;
  std::thread decider([&] {
    for (std::uint64_t cycle = 1; cycle <= kCycles; ++cycle) {
      if (cycle % kStopEvery == 0) latch.raise(std::uint64_t{2} << (cycle % 60), cycle);
      mailbox.publish(cycle);
    }
  });
  std::uint64_t newest_stop = 0;
  std::uint64_t lost = 0;
  for (std::uint64_t cycle = 0; cycle < kCycles;) {
    if (!mailbox.try_take(cycle)) {
      std::this_thread::yield();
      continue;
    }
    if (const auto stop = latch.take()) newest_stop = stop->sequence;
    if (newest_stop < cycle - cycle % kStopEvery) ++lost;
  }
  decider.join();
  EXPECT_EQ(lost, 0U);
}

TEST(StopLatch, NoReasonIsLostUnderConcurrentTakes) {
  constexpr std::uint64_t kRaises = 200'000;
  StopLatch latch;
  std::thread decider([&] {
    for (std::uint64_t n = 1; n <= kRaises; ++n) {
      // Bits 1 to 63 one after the other, so that a lost one is not raised again later.
      latch.raise(std::uint64_t{1} << (1 + n * 63 / (kRaises + 1)), n);
    }
  });
  std::uint64_t all = 0;
  std::uint64_t newest = 0;
  while (newest < kRaises) {
    if (const auto stop = latch.take()) {
      all |= stop->reasons;
      newest = stop->sequence;
    }
  }
  decider.join();
  if (const auto stop = latch.take()) all |= stop->reasons;
  EXPECT_EQ(all, ~std::uint64_t{1});
}

}  // namespace
}  // namespace holdfast::rt
