// SPDX-License-Identifier: Apache-2.0
// The real-time path makes no heap and no lock call. First that the guard itself trips.
#include "tests/rt/rt_guard.hpp"

#include <cstdlib>
#include <memory>
#include <mutex>
#include <set>
#include <string>

#include <gtest/gtest.h>

#include "rt/control_cycle.hpp"
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

/// The daemon's own cycle, with inputs, onto a tape that nobody empties: also its refusals count.
TEST(ControlCycle, RecordsWithoutHeapAndWithoutLocks) {
  RecordProperty("requirement", "SR-120");
  FrameArrivals arrivals;
  Mailbox<StampedEstimate> estimates;
  ControlInbox inbox;
  const auto tape = std::make_unique<CycleTape>();
  testing::VirtualInputs inputs;
  ControlCycle cycle(testing::healthy_parameters(), inputs.registration, arrivals, estimates, inbox,
                     tape.get());
  GuardCounts sum;
  safety::Timestamp now = testing::kStart;
  constexpr std::uint64_t kCycles = CycleTape::kCycles + 1500;
  for (CycleInfo info; info.index < kCycles; ++info.index) {
    now += std::chrono::milliseconds(1);
    const Readings readings = inputs.at(now);
    for (std::size_t i = 0; i < readings.arrival_count; ++i)
      ASSERT_TRUE(arrivals.try_push(readings.arrivals[i]));
    if (readings.estimate) estimates.publish(*readings.estimate);
    inbox.robot_status.publish(*readings.robot_status);
    const GuardCounts counts = counts_of([&] { cycle.run(info); });
    sum.allocations += counts.allocations;
    sum.locks += counts.locks;
  }
  EXPECT_EQ(sum.allocations, 0U);
  EXPECT_EQ(sum.locks, 0U);
  EXPECT_EQ(tape->dropped(), 1500U);
}

}  // namespace
}  // namespace holdfast::rt
