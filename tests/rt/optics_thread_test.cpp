// SPDX-License-Identifier: Apache-2.0
#include "rt/optics_thread.hpp"

#include <cmath>
#include <functional>
#include <map>
#include <utility>

#include <gtest/gtest.h>
#include <poll.h>

#include "bridge/can/local_can.hpp"
#include "rt/core/clock.hpp"
#include "tests/sim/microscope_node.hpp"

namespace holdfast::rt {
namespace {

using bridge::can::Fault;
using safety::Reason;
using namespace std::chrono_literals;

TEST(OpticsInput, GivesEachFaultItsReason) {
  RecordProperty("requirement", "SR-108");
  const std::map<Fault, Reason> expected = {
      {Fault::node_missing, Reason::microscope_missing},
      {Fault::node_not_operational, Reason::microscope_not_operational},
      {Fault::state_silent, Reason::microscope_silent},
      {Fault::bus_off, Reason::can_bus_off},
      {Fault::error_passive, Reason::can_error_passive},
      {Fault::transmit_queue_full, Reason::microscope_silent},
      {Fault::receive_overflow, Reason::can_overflow},
      {Fault::interface_down, Reason::can_down},
      {Fault::message_corrupt, Reason::microscope_corrupt},
      {Fault::counter_skipped, Reason::microscope_corrupt},
      {Fault::command_refused, Reason::microscope_silent},
      {Fault::command_unconfirmed, Reason::microscope_silent}};
  ASSERT_EQ(expected.size(), bridge::can::kFaultCount);
  for (const auto& [fault, reason] : expected) {
    bridge::can::MicroscopeReport report;
    report.faults.insert(fault);
    const safety::OpticsInput input = optics_input(report, 7ms);
    safety::ReasonSet only;
    only.insert(reason);
    EXPECT_EQ(input.faults, only) << name(fault);
    EXPECT_FALSE(input.is_known) << name(fault);
    EXPECT_EQ(input.t_report, 7ms);
  }
}

TEST(OpticsInput, CarriesWhatTheEncodersSay) {
  bridge::can::MicroscopeReport report;
  report.optics = bridge::can::Optics{1.3, 250, 40};
  report.is_moving = true;
  const safety::OpticsInput input = optics_input(report, 1ms);
  EXPECT_TRUE(input.has_report && input.is_known && input.is_moving);
  EXPECT_FALSE(input.is_declared_fixed);
  EXPECT_EQ(input.zoom, 1.3);
  EXPECT_EQ(input.focus_mm, 250);
}

TEST(OpticsParameters, SayWhatIsNotWatched) {
  RecordProperty("requirement", "SR-98");
  OpticsParameters parameters;
  parameters.interface = "can0";
  EXPECT_TRUE(optics_advisories(parameters).empty());
  parameters = {};
  parameters.local = "can.sock";
  EXPECT_EQ(optics_advisories(parameters).primary(), Reason::virtual_microscope);
  parameters = {};
  parameters.are_fixed = true;
  EXPECT_EQ(optics_advisories(parameters).primary(), Reason::optics_unwatched);
}

class OpticsThreadTest : public ::testing::Test {
 protected:
  OpticsThreadTest() {
    auto [ours, theirs] = bridge::can::LocalCan::make_pair();
    node_ =
        std::make_unique<sim::MicroscopeNode>(std::move(theirs), sim::MicroscopeNodeParameters{});
    CyclicThreadParameters thread;
    thread.fifo_priority.reset();
    thread_ = std::make_unique<OpticsThread>(std::move(ours), bridge::can::MicroscopeParameters{},
                                             thread, inbox_);
  }
  /// Lets the node speak until a look `holds`; false after a very long time.
  bool wait(const std::function<bool(const safety::OpticsInput&)>& holds) {
    const auto end = monotonic_now() + 30s;
    while (monotonic_now() < end) {
      node_->poll(monotonic_now());
      if (inbox_.newest.try_take(newest_) && holds(newest_)) return true;
      pollfd waiting{node_->transport().handle(), POLLIN, 0};
      ::poll(&waiting, 1, 1);
    }
    return false;
  }
  static bool is_well(const safety::OpticsInput& input) {
    return input.is_known && input.faults.empty();
  }

  OpticsInbox inbox_;
  safety::OpticsInput newest_;
  std::unique_ptr<sim::MicroscopeNode> node_;
  std::unique_ptr<OpticsThread> thread_;
};

TEST_F(OpticsThreadTest, TellsZoomAndFocusAndTheirChange) {
  ASSERT_TRUE(wait(is_well));
  EXPECT_EQ(newest_.zoom, 1.0);
  EXPECT_EQ(newest_.focus_mm, 200.0);
  node_->turn(bridge::can::Quantity::zoom, 1.4);
  EXPECT_TRUE(
      wait([](const auto& input) { return is_well(input) && std::abs(input.zoom - 1.4) < 1e-9; }));
}

TEST_F(OpticsThreadTest, MissesANodeThatWasNeverThere) {
  RecordProperty("requirement", "SR-91");
  node_->is_silent = true;
  EXPECT_TRUE(
      wait([](const auto& input) { return input.faults.contains(Reason::microscope_missing); }));
  EXPECT_FALSE(newest_.is_known);
}

TEST_F(OpticsThreadTest, ForgetsALastingFaultOnlyWhenAsked) {
  RecordProperty("requirement", "SR-108");
  ASSERT_TRUE(wait(is_well));
  bridge::can::Frame frame = encode(bridge::can::StateMessage{}, false);
  frame.data[0] ^= 1U;
  ASSERT_EQ(node_->transport().send(frame), bridge::can::SendResult::sent);
  ASSERT_TRUE(
      wait([](const auto& input) { return input.faults.contains(Reason::microscope_corrupt); }));
  int looks = 0;
  ASSERT_TRUE(wait([&](const auto& input) { return is_well(input) || ++looks == 100; }));
  EXPECT_FALSE(newest_.is_known);
  inbox_.recovery = true;
  EXPECT_TRUE(wait(is_well));
}

}  // namespace
}  // namespace holdfast::rt
