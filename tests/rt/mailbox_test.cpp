// SPDX-License-Identifier: Apache-2.0
#include "rt/core/mailbox.hpp"

#include <algorithm>
#include <array>
#include <cstdint>
#include <iterator>
#include <string>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

namespace holdfast::rt {
namespace {

static_assert(OwnsNothing<std::array<double, 36>>);
static_assert(!OwnsNothing<std::string>);
static_assert(!OwnsNothing<std::vector<int>>);

TEST(Mailbox, IsEmptyBeforeTheFirstPublish) {
  Mailbox<int> mailbox;
  int value = 7;
  EXPECT_FALSE(mailbox.try_take(value));
  EXPECT_EQ(value, 7);
}

TEST(Mailbox, GivesEachValueOnce) {
  Mailbox<int> mailbox;
  mailbox.publish(1);
  int value = 0;
  ASSERT_TRUE(mailbox.try_take(value));
  EXPECT_EQ(value, 1);
  EXPECT_FALSE(mailbox.try_take(value));
}

TEST(Mailbox, GivesTheNewestOfSeveral) {
  Mailbox<int> mailbox;
  int value = 0;
  for (int newest = 1; newest <= 9; ++newest) {
    for (int i = 1; i <= newest; ++i) mailbox.publish(i);
    ASSERT_TRUE(mailbox.try_take(value));
    EXPECT_EQ(value, newest);
  }
}

/// Every word holds the same number, so a torn copy shows.
struct Wide {
  std::array<std::uint64_t, 64> words{};
  Wide() = default;
  explicit Wide(std::uint64_t number) { words.fill(number); }
};

TEST(Mailbox, NeverTearsNorGoesBackNorLosesTheLastValue) {
  constexpr std::uint64_t kLast = 100'000;
  Mailbox<Wide> mailbox;
  std::thread writer([&] {
    for (std::uint64_t number = 1; number <= kLast; ++number) mailbox.publish(Wide(number));
  });
  std::uint64_t previous = 0;
  std::uint64_t faults = 0;
  for (Wide value; previous < kLast;) {
    if (!mailbox.try_take(value)) {
      std::this_thread::yield();
      continue;
    }
    if (std::ranges::count(value.words, value.words[0]) != std::ssize(value.words)) ++faults;
    if (value.words[0] <= previous) ++faults;
    previous = value.words[0];
  }
  writer.join();
  EXPECT_EQ(faults, 0U);
}

}  // namespace
}  // namespace holdfast::rt
