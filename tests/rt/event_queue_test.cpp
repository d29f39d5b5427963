// SPDX-License-Identifier: Apache-2.0
#include "rt/core/event_queue.hpp"

#include <algorithm>
#include <array>
#include <atomic>
#include <cstdint>
#include <iterator>
#include <thread>

#include <gtest/gtest.h>

namespace holdfast::rt {
namespace {

TEST(EventQueue, IsEmptyAtFirst) {
  EventQueue<int, 4> queue;
  int event = 7;
  EXPECT_FALSE(queue.try_pop(event));
  EXPECT_EQ(event, 7);
  EXPECT_EQ(queue.overflow_count(), 0U);
}

TEST(EventQueue, KeepsOrderAcrossTheWrap) {
  EventQueue<int, 4> queue;
  int event = 0;
  for (int round = 0; round < 5; ++round) {
    for (int i = 0; i < 3; ++i) ASSERT_TRUE(queue.try_push(10 * round + i));
    for (int i = 0; i < 3; ++i) {
      ASSERT_TRUE(queue.try_pop(event));
      EXPECT_EQ(event, 10 * round + i);
    }
  }
}

TEST(EventQueue, RefusesAndCountsWhenFullAndKeepsWhatItHas) {
  EventQueue<int, 4> queue;
  for (int i = 0; i < 4; ++i) ASSERT_TRUE(queue.try_push(i));
  EXPECT_FALSE(queue.try_push(4));
  EXPECT_FALSE(queue.try_push(5));
  EXPECT_EQ(queue.overflow_count(), 2U);
  int event = -1;
  ASSERT_TRUE(queue.try_pop(event));
  EXPECT_EQ(event, 0);
  EXPECT_TRUE(queue.try_push(6));
  EXPECT_EQ(queue.overflow_count(), 2U);
}

TEST(EventQueue, EachEventArrivesWholeAndInOrderOrIsCounted) {
  using Event = std::array<std::uint64_t, 16>;
  constexpr std::uint64_t kPushes = 200'000;
  EventQueue<Event, 8> queue;
  std::atomic<bool> is_done{false};
  std::uint64_t accepted = 0;
  std::thread writer([&] {
    for (std::uint64_t number = 1; number <= kPushes; ++number) {
      Event event;
      event.fill(number);
      if (queue.try_push(event)) ++accepted;
    }
    is_done.store(true);
  });
  std::uint64_t popped = 0;
  std::uint64_t previous = 0;
  std::uint64_t faults = 0;
  Event event{};
  for (bool was_done = false;;) {
    was_done = is_done.load();  // before the pop: whatever is pushed is visible when it is set
    if (!queue.try_pop(event)) {
      if (was_done) break;
      std::this_thread::yield();
      continue;
    }
    if (std::ranges::count(event, event[0]) != std::ssize(event)) ++faults;
    if (event[0] <= previous) ++faults;
    previous = event[0];
    ++popped;
  }
  writer.join();
  EXPECT_EQ(faults, 0U);
  EXPECT_EQ(popped, accepted);
  EXPECT_EQ(popped + queue.overflow_count(), kPushes);
}

}  // namespace
}  // namespace holdfast::rt
