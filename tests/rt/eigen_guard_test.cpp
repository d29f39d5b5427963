// SPDX-License-Identifier: Apache-2.0
// The control step and the gate, compiled once more with Eigen's own allocation guard.
#include <memory>

#include <Eigen/Core>
#include <gtest/gtest.h>

#include "tests/rt/rt_path.hpp"

#ifndef EIGEN_RUNTIME_NO_MALLOC
#error "without EIGEN_RUNTIME_NO_MALLOC this test proves nothing"
#endif

namespace holdfast::rt {
namespace {

TEST(EigenGuardDeathTest, TripsOnADynamicMatrix) {
  EXPECT_DEATH(
      {
        Eigen::internal::set_is_malloc_allowed(false);
        const Eigen::VectorXd vector(100);
      },
      "is_malloc_allowed");
}

TEST(EigenGuard, TheControlStepAllocatesNothing) {
  RecordProperty("requirement", "SR-70");
  const auto path = std::make_unique<testing::RtPath>();
  int cycles = 0;
  testing::run_every_kind_of_day(*path, [&](testing::RtPath& p, safety::Timestamp now) {
    Eigen::internal::set_is_malloc_allowed(false);
    p.cycle(now);  // an allocation aborts
    Eigen::internal::set_is_malloc_allowed(true);
    ++cycles;
  });
  EXPECT_EQ(cycles, 10'000);
}

}  // namespace
}  // namespace holdfast::rt
