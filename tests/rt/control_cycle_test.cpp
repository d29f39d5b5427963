// SPDX-License-Identifier: Apache-2.0
#include "rt/control_cycle.hpp"

#include <memory>

#include <gtest/gtest.h>

namespace holdfast::rt {
namespace {

using safety::Reason;
using namespace std::chrono_literals;

class ControlCycleTest : public ::testing::Test {
 protected:
  void run(std::chrono::nanoseconds lateness = 0ns) {
    CycleInfo info;
    info.index = index_++;
    info.lateness = lateness;
    cycle_->run(info);
    ASSERT_TRUE(cycle_->reports().try_take(report_));
  }
  [[nodiscard]] const safety::Decision& decision() const { return report_.output.decision; }

  FrameArrivals arrivals_;
  Mailbox<StampedEstimate> estimates_;
  ControlInbox inbox_;
  std::unique_ptr<ControlCycle> cycle_ = std::make_unique<ControlCycle>(
      ControlParameters{}, safety::RegistrationInput{}, arrivals_, estimates_, inbox_);
  std::uint64_t index_ = 0;
  CycleReport report_;
};

TEST_F(ControlCycleTest, StartsWithoutPermission) {
  run();
  EXPECT_FALSE(decision().approved.has_value());
  EXPECT_EQ(decision().mode, safety::Mode::init);
}

TEST_F(ControlCycleTest, TurnsAnOverflowingQueueIntoAStop) {
  RecordProperty("requirement", "SR-72");
  run();
  FrameArrival arrival;
  arrival.is_connected = true;
  while (arrivals_.try_push(arrival)) {
  }
  run();
  EXPECT_TRUE(decision().reasons.contains(Reason::internal_fault));
  EXPECT_EQ(decision().mode, safety::Mode::stop_latched);
}

TEST_F(ControlCycleTest, ReportsALateWakeUpToTheGate) {
  RecordProperty("requirement", "SR-71");
  run(safety::Limits{}.loop_lateness_max);
  EXPECT_FALSE(decision().reasons.contains(Reason::loop_overrun));
  run(safety::Limits{}.loop_lateness_max + 1ns);
  EXPECT_TRUE(decision().reasons.contains(Reason::loop_overrun));
}

TEST_F(ControlCycleTest, ReportsACorruptMessageOnce) {
  run();
  inbox_.message_corrupt = true;
  run();
  EXPECT_TRUE(decision().reasons.contains(Reason::message_corrupt));
  run();
  EXPECT_FALSE(decision().reasons.contains(Reason::message_corrupt));
}

TEST_F(ControlCycleTest, KeepsReportingASecondPublisherWhileItIsThere) {
  RecordProperty("requirement", "SR-81");
  inbox_.second_publisher = true;
  run();
  run();
  EXPECT_TRUE(decision().reasons.contains(Reason::second_publisher));
}

TEST_F(ControlCycleTest, LatchesEachWithdrawalForThePublisher) {
  RecordProperty("requirement", "SR-73");
  run(1s);  // loop_overrun
  run();    // its report overtakes the first one
  run();
  const auto withdrawal = cycle_->withdrawals().take();
  ASSERT_TRUE(withdrawal.has_value());
  EXPECT_TRUE(safety::ReasonSet{withdrawal->reasons}.contains(Reason::loop_overrun));
  EXPECT_FALSE(cycle_->withdrawals().take().has_value());
}

TEST_F(ControlCycleTest, HandsEachOperatorCommandToOneCycle) {
  ASSERT_TRUE(inbox_.commands.try_push({safety::Command::arm, 0}));
  ASSERT_TRUE(inbox_.commands.try_push({safety::Command::stop, 0}));
  run();
  EXPECT_NE(decision().mode, safety::Mode::stop_latched);
  run();
  EXPECT_EQ(decision().mode, safety::Mode::stop_latched);
  EXPECT_TRUE(decision().reasons.contains(Reason::operator_stop));
}

}  // namespace
}  // namespace holdfast::rt
