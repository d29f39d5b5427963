// SPDX-License-Identifier: Apache-2.0
#include <gtest/gtest.h>

#include "bridge/dds/inputs.hpp"
#include "tests/bridge/dds_domain.hpp"

namespace holdfast::bridge::dds {
namespace {

using safety::Command;

class InputReaderTest : public testing::Test {
 public:
  void SetUp() override {
    ASSERT_TRUE(
        eventually([&] { return robot.status().matched == 1 && console.status().matched == 1; }));
  }
  template <class M>
  void send(const Writer<M>& writer, M m, std::uint32_t counter) {
    protect(m, 7, counter, std::chrono::milliseconds(500), read_clocks());
    ASSERT_TRUE(writer.write(m));
  }
  // Polls until something has come.
  ReceivedInputs received() {
    ReceivedInputs r;
    EXPECT_TRUE(eventually([&] {
      r = inputs.poll();
      return r.robot || r.is_corrupt || !r.commands().empty();
    }));
    return r;
  }

  Participant participant{{.domain = test_domain(), .configuration = {}}};
  InputReader inputs{participant};
  Writer<msg::RobotStatus> robot{participant};
  Writer<msg::OperatorCommand> console{participant};
};

TEST_F(InputReaderTest, NothingArrivedIsNothing) {
  const auto r = inputs.poll();
  EXPECT_FALSE(r.robot.has_value());
  EXPECT_TRUE(r.commands().empty());
  EXPECT_FALSE(r.is_corrupt);
}

TEST_F(InputReaderTest, GivesTheRobotsStatusWithItsReception) {
  const auto before = read_clocks().monotonic;
  send(robot, {}, 1);
  const auto r = received();
  ASSERT_TRUE(r.robot.has_value());
  EXPECT_TRUE(r.robot->has_status);
  EXPECT_FALSE(r.robot->has_fault);
  EXPECT_GE(r.robot->t_last_status, before);
  EXPECT_LE(r.robot->t_last_status, read_clocks().monotonic);
}

TEST_F(InputReaderTest, GivesACommandWithItsStopId) {
  msg::OperatorCommand command{};
  command.command = static_cast<std::uint8_t>(Command::acknowledge);
  command.stop_id = 12;
  send(console, command, 1);
  const auto r = received();
  ASSERT_EQ(r.commands().size(), 1U);
  EXPECT_EQ(r.commands()[0].command, Command::acknowledge);
  EXPECT_EQ(r.commands()[0].stop_id, 12U);
  EXPECT_FALSE(r.is_corrupt);
}

TEST_F(InputReaderTest, AnUnknownCommandIsAStop) {
  msg::OperatorCommand command{};
  command.command = 77;
  send(console, command, 1);
  const auto r = received();
  ASSERT_EQ(r.commands().size(), 1U);
  EXPECT_EQ(r.commands()[0].command, Command::stop);
}

TEST_F(InputReaderTest, ACorruptStatusIsReportedAndNotSeen) {
  RecordProperty("requirement", "SR-84");
  msg::RobotStatus status{};
  protect(status, 7, 1, std::chrono::milliseconds(100), read_clocks());
  status.is_enabled = true;  // after the CRC
  ASSERT_TRUE(robot.write(status));
  const auto r = received();
  EXPECT_TRUE(r.is_corrupt);
  EXPECT_FALSE(r.robot.has_value());
}

TEST_F(InputReaderTest, ACorruptCommandIsReportedAndNotSeen) {
  RecordProperty("requirement", "SR-84");
  msg::OperatorCommand command{};
  protect(command, 7, 1, std::chrono::milliseconds(100), read_clocks());
  command.command = static_cast<std::uint8_t>(Command::arm);
  ASSERT_TRUE(console.write(command));
  const auto r = received();
  EXPECT_TRUE(r.is_corrupt);
  EXPECT_TRUE(r.commands().empty());
}

TEST_F(InputReaderTest, ARepeatedCommandIsReportedAndNotSeen) {
  RecordProperty("requirement", "SR-84");
  msg::OperatorCommand command{};
  command.command = static_cast<std::uint8_t>(Command::arm);
  send(console, command, 1);
  EXPECT_EQ(received().commands().size(), 1U);
  send(console, command, 1);
  const auto r = received();
  EXPECT_TRUE(r.is_corrupt);
  EXPECT_TRUE(r.commands().empty());
}

TEST_F(InputReaderTest, ALostStatusIsToleratedALostCommandIsNot) {
  send(robot, {}, 1);
  (void)received();
  send(robot, {}, 3);
  EXPECT_FALSE(received().is_corrupt);
  send(console, {}, 1);
  (void)received();
  send(console, {}, 3);
  EXPECT_TRUE(received().is_corrupt);
}

TEST_F(InputReaderTest, AFaultBetweenTwoPollsIsKept) {
  msg::RobotStatus fault{};
  fault.has_fault = true;
  send(robot, fault, 1);
  send(robot, {}, 2);
  ASSERT_TRUE(robot.wait_for_acknowledgements(std::chrono::seconds(20)));
  bool saw_fault = false;
  int statuses = 0;
  ASSERT_TRUE(eventually([&] {
    const auto r = inputs.poll();
    if (r.robot) {
      saw_fault = saw_fault || r.robot->has_fault;
      ++statuses;
    }
    return statuses > 0;
  }));
  EXPECT_TRUE(saw_fault);
}

}  // namespace
}  // namespace holdfast::bridge::dds
