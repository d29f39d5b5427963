// SPDX-License-Identifier: Apache-2.0
// The gate and the receiver, compiled here with EIGEN_RUNTIME_NO_MALLOC, in every mode and with
// every fault: neither Eigen nor operator new may allocate.
#include <atomic>
#include <cstdlib>
#include <new>
#include <vector>

#include <Eigen/Core>
#include <gtest/gtest.h>

#include "safety/end_to_end.hpp"
#include "safety/mode_table.hpp"
#include "tests/safety/faults.hpp"

namespace {
std::atomic<int> allocations{0};
}  // namespace

void* operator new(std::size_t size) {
  ++allocations;
  if (void* memory = std::malloc(size)) return memory;  // NOLINT(cppcoreguidelines-no-malloc)
  throw std::bad_alloc();
}
void operator delete(void* memory) noexcept {
  std::free(memory);  // NOLINT(cppcoreguidelines-no-malloc)
}
void operator delete(void* memory, std::size_t) noexcept {
  std::free(memory);  // NOLINT(cppcoreguidelines-no-malloc)
}

namespace holdfast::safety {
namespace {

/// Eigen's allocations abort and operator new is counted while it lives.
class AllocationGuard {
 public:
  AllocationGuard() { Eigen::internal::set_is_malloc_allowed(false); }
  ~AllocationGuard() { Eigen::internal::set_is_malloc_allowed(true); }
  AllocationGuard(const AllocationGuard&) = delete;
  AllocationGuard& operator=(const AllocationGuard&) = delete;
  [[nodiscard]] int count() const { return allocations - before_; }

 private:
  int before_ = allocations;
};

TEST(AllocationGuardTest, SeesAnAllocation) {
  AllocationGuard guard;
  const std::vector<int> memory(100);
  EXPECT_EQ(guard.count(), 1);
}

TEST(AllocationGuardDeathTest, AbortsWhenEigenAllocates) {
  EXPECT_DEATH(
      {
        AllocationGuard guard;
        Eigen::MatrixXd matrix(64, 64);
        matrix.setZero();
      },
      "is_malloc_allowed");
}

TEST(Gate, DecidesWithoutAllocationInEveryModeAndFault) {
  RecordProperty("requirement", "SR-30");
  test::GateDriver driver;
  driver.to_permitted();
  const GateState permitted = driver.state;
  std::vector<Inputs> cycles;
  for (const test::Fault& fault : test::all_faults()) {
    cycles.push_back(test::good_inputs(driver.now += std::chrono::milliseconds(1)));
    fault.inject(cycles.back(), driver.limits);
  }
  cycles.push_back(test::good_inputs(driver.now += std::chrono::milliseconds(1)));

  int approved = 0;
  const AllocationGuard guard;
  for (std::uint8_t mode = 0; mode <= static_cast<std::uint8_t>(Mode::stop_latched) + 1; ++mode) {
    for (const Inputs& inputs : cycles) {
      GateState state = permitted;
      state.mode = static_cast<Mode>(mode);
      approved += Gate::decide(driver.limits, inputs, state).approved.has_value() ? 1 : 0;
    }
  }
  EXPECT_EQ(guard.count(), 0);
  EXPECT_GT(approved, 0);
}

TEST(Receiver, ChecksWithoutAllocation) {
  RecordProperty("requirement", "SR-30");
  Receiver receiver(DataId::compensated_pose, {});
  Protection protection;
  protection.data_id = DataId::compensated_pose;
  protection.source = 1;
  const AllocationGuard guard;
  for (std::uint32_t i = 0; i < 10; ++i) {
    protection.counter = i / 2;  // half of them repeated
    (void)receiver.check(protection, 0, {}, {});
  }
  EXPECT_EQ(guard.count(), 0);
}

}  // namespace
}  // namespace holdfast::safety
