// SPDX-License-Identifier: Apache-2.0
#include "registration/worker_pool.hpp"

#include <array>
#include <latch>
#include <stdexcept>
#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace holdfast::registration {
namespace {

TEST(WorkerPool, RunsEveryTaskOnceWithAnyNumberOfThreads) {
  for (const int threads : {1, 2, 5}) {
    WorkerPool pool(threads);
    EXPECT_EQ(pool.threads(), threads);
    for (const int count : {0, 1, 2, 1000}) {
      std::vector<int> runs(static_cast<std::size_t>(count));
      pool.run(count, [&](int k) { ++runs[static_cast<std::size_t>(k)]; });
      EXPECT_EQ(runs, std::vector<int>(runs.size(), 1)) << threads << " threads";
    }
  }
}

/// Throws the task's number, and by that lets the next in turn throw.
void fail_in_turn(int number, int turn, std::array<std::latch, 5>& turns) {
  turns.at(static_cast<std::size_t>(turn)).wait();
  struct Next {
    std::latch& latch;
    ~Next() { latch.count_down(); }
  } const next{turns.at(static_cast<std::size_t>(turn) + 1)};
  throw std::runtime_error(std::to_string(number));
}

TEST(WorkerPool, ThrowsTheFailureOfTheSmallestNumberWhicheverComesFirst) {
  WorkerPool pool(4);
  for (const bool is_smallest_first : {true, false}) {
    std::latch all_begun(4);
    std::array turns = {std::latch(0), std::latch(1), std::latch(1), std::latch(1), std::latch(1)};
    const auto task = [&](int k) {
      all_begun.arrive_and_wait();
      fail_in_turn(k, is_smallest_first ? k : 3 - k, turns);
    };
    try {
      pool.run(4, task);
      FAIL() << "a failure went unnoticed";
    } catch (const std::runtime_error& e) {
      EXPECT_STREQ(e.what(), "0") << "smallest first: " << is_smallest_first;
    }
  }
}

TEST(WorkerPool, BeginsNothingAfterAFailureAndServesAgain) {
  WorkerPool pool(1);
  int begun = 0;
  const auto task = [&](int k) {
    ++begun;
    if (k == 3) throw std::runtime_error("");
  };
  EXPECT_THROW(pool.run(10, task), std::runtime_error);
  EXPECT_EQ(begun, 4);
  pool.run(3, task);
  EXPECT_EQ(begun, 7);
}

}  // namespace
}  // namespace holdfast::registration
