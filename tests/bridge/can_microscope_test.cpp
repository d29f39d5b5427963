// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <memory>

#include <gtest/gtest.h>
#include <linux/can/error.h>

#include "bridge/can/local_can.hpp"
#include "bridge/can/microscope.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/microscope_node.hpp"

namespace holdfast::bridge::can {
namespace {

using namespace std::chrono_literals;

/// A transport that fails as told and delivers what is put in.
class ScriptedTransport : public Transport {
 public:
  SendResult send(const Frame& /*frame*/) noexcept override { return result; }
  bool receive(Frame& frame) noexcept override {
    if (!has_frame) return false;
    frame = next;
    has_frame = false;
    return true;
  }
  std::uint64_t dropped() const noexcept override { return drops; }
  bool is_up() noexcept override { return up; }
  bool restart() noexcept override {
    ++restarts;
    return can_restart;
  }
  int handle() const noexcept override { return -1; }
  void deliver(const Frame& frame) {
    next = frame;
    has_frame = true;
  }
  SendResult result = SendResult::sent;
  Frame next;
  bool has_frame = false, up = true, can_restart = true;
  std::uint64_t drops = 0;
  int restarts = 0;
};

/// Microscope and virtual node on a local bus, in virtual time.
class MicroscopeOnTheBus : public ::testing::Test {
 protected:
  explicit MicroscopeOnTheBus(const MicroscopeParameters& parameters = {}) {
    auto [ours, theirs] = LocalCan::make_pair();
    node_ =
        std::make_unique<sim::MicroscopeNode>(std::move(theirs), sim::MicroscopeNodeParameters{});
    microscope_ = std::make_unique<Microscope>(std::move(ours), parameters, now_);
  }
  void run(std::chrono::nanoseconds duration) {
    for (const auto end = now_ + duration; now_ < end;) {
      now_ += 1ms;
      node_->poll(now_);
      report_ = microscope_->poll(now_);
    }
  }
  std::chrono::nanoseconds now_ = 1000s;
  std::unique_ptr<sim::MicroscopeNode> node_;
  std::unique_ptr<Microscope> microscope_;
  MicroscopeReport report_;
};

TEST_F(MicroscopeOnTheBus, ReportsTheEncodersValues) {
  run(50ms);
  ASSERT_TRUE(report_.optics);
  EXPECT_NEAR(report_.optics->zoom, 1.0, 1e-4);
  EXPECT_NEAR(report_.optics->focus_mm, 200, 1e-3);
  EXPECT_TRUE(report_.faults.empty());
  node_->turn(Quantity::zoom, 1.6);  // by hand: no command of ours
  run(25ms);
  ASSERT_TRUE(report_.optics);
  EXPECT_NEAR(report_.optics->zoom, 1.6, 1e-4);
}

TEST_F(MicroscopeOnTheBus, ConfirmsACommandWhenTheDriveHasArrived) {
  RecordProperty("requirement", "SR-95");
  run(50ms);
  ASSERT_TRUE(microscope_->command(Quantity::zoom, 1.2, now_));
  EXPECT_FALSE(microscope_->command(Quantity::zoom, 1.3, now_));  // one at a time
  run(100ms);
  EXPECT_FALSE(microscope_->confirmed());
  EXPECT_TRUE(report_.is_moving);
  run(150ms);
  ASSERT_TRUE(microscope_->confirmed());
  EXPECT_NEAR(microscope_->confirmed()->value, 1.2, 1e-4);
  EXPECT_FALSE(report_.is_moving);
}

TEST_F(MicroscopeOnTheBus, NamesACommandThatIsRefusedOrNotAnswered) {
  RecordProperty("requirement", "SR-95");
  run(50ms);
  ASSERT_TRUE(microscope_->command(Quantity::zoom, 6.0, now_));  // beyond the drive
  run(5ms);
  EXPECT_TRUE(report_.faults.contains(Fault::command_refused));
  EXPECT_FALSE(microscope_->confirmed());
  ASSERT_TRUE(microscope_->recover(now_));
  run(50ms);
  node_->is_silent = true;
  ASSERT_TRUE(microscope_->command(Quantity::zoom, 1.2, now_));
  run(10s + 2ms);
  EXPECT_TRUE(report_.faults.contains(Fault::command_unconfirmed));
}

TEST_F(MicroscopeOnTheBus, RefusesToSendWhatTheFrameCannotCarry) {
  EXPECT_FALSE(microscope_->command(Quantity::zoom, 7.0, now_));
  EXPECT_FALSE(microscope_->command(Quantity::zoom, -1.0, now_));
  EXPECT_FALSE(microscope_->command(Quantity::illumination, std::nan(""), now_));
}

TEST_F(MicroscopeOnTheBus, MissesANodeThatWasNeverThereWithinTwoPeriods) {
  RecordProperty("requirement", "SR-91");
  node_->is_silent = true;
  run(30ms);
  EXPECT_FALSE(report_.faults.contains(Fault::node_missing));
  run(1ms);
  EXPECT_TRUE(report_.faults.contains(Fault::node_missing));
  EXPECT_FALSE(report_.optics);
}

TEST_F(MicroscopeOnTheBus, MissesANodeThatFallsSilentAndHasNoLastKnownValue) {
  RecordProperty("requirement", "SR-91,SR-92");
  run(60ms);
  ASSERT_TRUE(report_.optics);
  node_->is_silent = true;
  run(41ms);
  EXPECT_TRUE(report_.faults.contains(Fault::node_missing));
  EXPECT_TRUE(report_.faults.contains(Fault::state_silent));
  EXPECT_FALSE(report_.optics);
  node_->is_silent = false;
  run(21ms);
  EXPECT_TRUE(report_.faults.empty());
  EXPECT_TRUE(report_.optics);
}

TEST_F(MicroscopeOnTheBus, ANodeThatBeatsButIsStoppedIsAFault) {
  node_->state = NodeState::stopped;
  run(50ms);
  EXPECT_TRUE(report_.faults.contains(Fault::node_not_operational));
  EXPECT_FALSE(report_.optics);
}

class MicroscopeFaults : public ::testing::Test {
 protected:
  MicroscopeFaults() {
    auto transport = std::make_unique<ScriptedTransport>();
    bus_ = transport.get();
    microscope_ = std::make_unique<Microscope>(std::move(transport), MicroscopeParameters{}, 0ns);
  }
  FaultSet after(const Frame& frame) {
    bus_->deliver(frame);
    return microscope_->poll(1ms).faults;
  }
  static Frame error(std::uint32_t classes, std::uint8_t controller = 0) {
    Frame frame;
    frame.is_error = true;
    frame.id = classes;
    frame.size = 8;
    frame.data[1] = controller;
    return frame;
  }
  ScriptedTransport* bus_ = nullptr;
  std::unique_ptr<Microscope> microscope_;
};

TEST_F(MicroscopeFaults, BusOffStaysUntilItIsRecovered) {
  RecordProperty("requirement", "SR-93");
  EXPECT_TRUE(after(error(CAN_ERR_BUSOFF)).contains(Fault::bus_off));
  EXPECT_TRUE(microscope_->poll(2ms).faults.contains(Fault::bus_off));
  EXPECT_EQ(bus_->restarts, 0);
  bus_->can_restart = false;
  EXPECT_FALSE(microscope_->recover(2ms));
  EXPECT_TRUE(microscope_->poll(2ms).faults.contains(Fault::bus_off));
  bus_->can_restart = true;
  EXPECT_TRUE(microscope_->recover(2ms));
  EXPECT_FALSE(microscope_->poll(2ms).faults.contains(Fault::bus_off));
  EXPECT_EQ(bus_->restarts, 2);
}

TEST_F(MicroscopeFaults, ErrorPassiveEndsWhenTheControllerIsActiveAgain) {
  RecordProperty("requirement", "SR-93");
  EXPECT_TRUE(after(error(CAN_ERR_CRTL, CAN_ERR_CRTL_TX_PASSIVE)).contains(Fault::error_passive));
  EXPECT_FALSE(after(error(CAN_ERR_CRTL, CAN_ERR_CRTL_ACTIVE)).contains(Fault::error_passive));
  EXPECT_TRUE(after(error(CAN_ERR_CRTL, CAN_ERR_CRTL_RX_PASSIVE)).contains(Fault::error_passive));
}

TEST_F(MicroscopeFaults, AFullQueueADeadInterfaceAndALossAreNamed) {
  RecordProperty("requirement", "SR-93");
  bus_->result = SendResult::queue_full;
  EXPECT_FALSE(microscope_->command(Quantity::zoom, 1, 1ms));
  EXPECT_TRUE(microscope_->poll(1ms).faults.contains(Fault::transmit_queue_full));
  bus_->drops = 1;
  EXPECT_TRUE(microscope_->poll(1ms).faults.contains(Fault::receive_overflow));
  EXPECT_TRUE(
      after(error(CAN_ERR_CRTL, CAN_ERR_CRTL_RX_OVERFLOW)).contains(Fault::receive_overflow));
  bus_->up = false;
  EXPECT_TRUE(microscope_->poll(1ms).faults.contains(Fault::interface_down));
  bus_->up = true;
  EXPECT_FALSE(microscope_->poll(1ms).faults.contains(Fault::interface_down));
  EXPECT_TRUE(microscope_->recover(1ms));
  EXPECT_TRUE(microscope_->poll(1ms).faults.empty());
}

TEST_F(MicroscopeFaults, ACorruptOrSkippedMessageLeavesTheOpticsInDoubt) {
  RecordProperty("requirement", "SR-92,SR-94");
  EXPECT_TRUE(after(encode(StateMessage{{1, 200, 50}, false, 0}, false)).empty());
  EXPECT_TRUE(microscope_->poll(1ms).optics);
  EXPECT_TRUE(
      after(encode(StateMessage{{1, 200, 50}, false, 2}, false)).contains(Fault::counter_skipped));
  EXPECT_FALSE(microscope_->poll(1ms).optics);
  ASSERT_TRUE(microscope_->recover(1ms));
  Frame bad = encode(StateMessage{{1, 200, 50}, false, 3}, false);
  bad.data[0] ^= 1;
  EXPECT_TRUE(after(bad).contains(Fault::message_corrupt));
  EXPECT_FALSE(microscope_->poll(1ms).optics);
}

TEST_F(MicroscopeFaults, ARepeatedMessageIsASkippedCounter) {
  RecordProperty("requirement", "SR-94");
  const Frame state = encode(StateMessage{{1, 200, 50}, false, 0}, false);
  EXPECT_TRUE(after(state).empty());
  EXPECT_TRUE(after(state).contains(Fault::counter_skipped));
}

TEST(MicroscopeParametersTest, RefusesWhatIsOutOfRange) {
  MicroscopeParameters parameters;
  parameters.node = 128;
  EXPECT_THROW(Microscope(std::move(LocalCan::make_pair().first), parameters, 0ns), InputError);
  parameters = {};
  parameters.heartbeat_period = 0ns;
  EXPECT_THROW(Microscope(std::move(LocalCan::make_pair().first), parameters, 0ns), InputError);
}

TEST(LocalCanTest, FindsItsPeerAgainAfterThatRestarted) {
  const std::string path = ::testing::TempDir() + "holdfast_local_can";
  const auto caller = LocalCan::connect(path);
  Frame frame = encode(HeartbeatMessage{}, 1, false);
  EXPECT_EQ(caller->send(frame), SendResult::queue_full);  // alone on the bus
  for (int life = 0; life < 2; ++life) {
    const auto node = LocalCan::listen(path);
    EXPECT_FALSE(caller->receive(frame));
    EXPECT_FALSE(caller->receive(frame));  // the first noticed the end of the previous life
    EXPECT_FALSE(node->receive(frame));
    EXPECT_EQ(caller->send(encode(HeartbeatMessage{}, 1, false)), SendResult::sent);
    EXPECT_TRUE(node->receive(frame));
    EXPECT_EQ(node->send(encode(StateMessage{}, true)), SendResult::sent);
    EXPECT_TRUE(caller->receive(frame));
    EXPECT_TRUE(frame.is_fd);
  }
}

TEST(LocalCanTest, AQueueThatNobodyEmptiesIsFull) {
  const auto [ours, theirs] = LocalCan::make_pair();
  const Frame frame = encode(HeartbeatMessage{}, 1, false);
  int sent = 0;
  while (sent < 100'000 && ours->send(frame) == SendResult::sent) ++sent;
  EXPECT_LT(sent, 100'000);
  EXPECT_EQ(ours->send(frame), SendResult::queue_full);
}

}  // namespace
}  // namespace holdfast::bridge::can
