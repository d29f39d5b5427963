// SPDX-License-Identifier: Apache-2.0
// The real-time path makes no heap and no lock call. First that the guard itself trips.
#include "tests/rt/rt_guard.hpp"

#include <cstdlib>
#include <memory>
#include <mutex>
#include <set>
#include <string>

#include <gtest/gtest.h>

#include "tests/rt/rt_path.hpp"

namespace holdfast::rt {
namespace {

using testing::GuardCounts;
using testing::RtGuard;

template <typename Body>
GuardCounts counts_of(Body body) {
  const RtGuard guard;
  body();
  return guard.counts();
}

TEST(RtGuard, CountsNothingWhenNothingHappens) {
  const GuardCounts counts = counts_of([] {});
  EXPECT_EQ(counts.allocations, 0U);
  EXPECT_EQ(counts.locks, 0U);
}

TEST(RtGuard, TripsOnOneMalloc) {
  void* volatile memory = nullptr;
  // NOLINTBEGIN(cppcoreguidelines-no-malloc): the guard must see the bare calls
  EXPECT_EQ(counts_of([&] { memory = std::malloc(8); }).allocations, 1U);
  EXPECT_EQ(counts_of([&] { std::free(memory); }).allocations, 1U);
  // NOLINTEND(cppcoreguidelines-no-malloc)
}

TEST(RtGuard, TripsOnNewAndOnAllocationsInsideTheStandardLibrary) {
  std::unique_ptr<int> number;
  EXPECT_EQ(counts_of([&] { number = std::make_unique<int>(1); }).allocations, 1U);
  struct alignas(64) Aligned {
    char bytes[64];
  };
  std::unique_ptr<Aligned> aligned;
  EXPECT_GE(counts_of([&] { aligned = std::make_unique<Aligned>(); }).allocations, 1U);
  std::string text;
  EXPECT_GE(counts_of([&] { text.assign(100, 'x'); }).allocations, 1U);
}

TEST(RtGuard, TripsOnOneLock) {
  std::mutex mutex;
  EXPECT_EQ(counts_of([&] { mutex.lock(); }).locks, 1U);
  mutex.unlock();
  EXPECT_EQ(counts_of([&] { (void)mutex.try_lock(); }).locks, 1U);
  mutex.unlock();
}

TEST(ControlStep, RunsWithoutHeapAndWithoutLocks) {
  RecordProperty("requirement", "SR-70");
  const auto path = std::make_unique<testing::RtPath>();
  std::uint64_t allocations = 0;
  std::uint64_t locks = 0;
  std::uint64_t cycles = 0;
  std::set<safety::Mode> modes;
  testing::run_every_kind_of_day(*path, [&](testing::RtPath& p, safety::Timestamp now) {
    const GuardCounts counts = counts_of([&] { p.cycle(now); });
    allocations += counts.allocations;
    locks += counts.locks;
    ++cycles;
    modes.insert(p.mode);
  });
  EXPECT_EQ(cycles, 10'000U);
  EXPECT_EQ(allocations, 0U);
  EXPECT_EQ(locks, 0U);
  // The day went through every mode, so every branch of the gate's table was on the path.
  EXPECT_TRUE(modes.contains(safety::Mode::permitted));
  EXPECT_TRUE(modes.contains(safety::Mode::hold));
  EXPECT_TRUE(modes.contains(safety::Mode::stop_latched));
}

}  // namespace
}  // namespace holdfast::rt
