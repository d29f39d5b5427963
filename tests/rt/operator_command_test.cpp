// SPDX-License-Identifier: Apache-2.0
// The virtual operator and the virtual robot as processes, against a real gate and the real wire:
// what they do must pass the daemon's checks and have the effect that it claims.
#include <algorithm>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include "bridge/dds/inputs.hpp"
#include "bridge/dds/messages.hpp"
#include "tests/bridge/dds_domain.hpp"
#include "tests/bridge/scripted_daemon.hpp"
#include "tests/safety/good_inputs.hpp"
#include "tests/sim/demo/child_process.hpp"

namespace holdfast::sim {
namespace {

using namespace std::chrono_literals;
namespace dds = bridge::dds;
namespace fs = std::filesystem;
using safety::Command;
using safety::Mode;

constexpr std::chrono::seconds kPatience{60};  // reached only when the test fails

class RoomTest : public ::testing::Test {
 protected:
  void SetUp() override { fs::create_directories(folder_); }
  void TearDown() override { fs::remove_all(folder_); }

  ChildProcess start(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin() + 1, {"--domain", std::to_string(dds::test_domain())});
    return {HOLDFAST_SIM, arguments, log_};
  }
  static std::string content(const fs::path& file) {
    std::stringstream text;
    text << std::ifstream(file).rdbuf();
    return text.str();
  }

  /// The JSON object in the log, after what the middleware may have said on stderr.
  [[nodiscard]] nlohmann::json result() const {
    const std::string text = content(log_);
    return nlohmann::json::parse(text.substr(std::min(text.size(), text.find("{\""))));
  }

  const fs::path folder_ =
      fs::temp_directory_path() / ("holdfast-room-" + std::to_string(::getpid()));
  const fs::path log_ = folder_ / "log.txt";
  dds::Participant participant_{{.domain = dds::test_domain(), .configuration = {}}};
  dds::InputReader inputs_{participant_};
};

/// A daemon that is nothing but a gate, with inputs in perfect order and a time of its own.
class OperatorProcess : public RoomTest {
 protected:
  void SetUp() override {
    RoomTest::SetUp();
    shown_ = gate_.to_permitted();
    ASSERT_EQ(shown_.mode, Mode::permitted);
  }

  void show() {
    msg::MotionStop stop = dds::to_message(shown_, gate_.now, gate_.now);
    (void)stops_.publish(stop);
  }
  /// Gives the gate what has come; the commands, in order.
  void serve() {
    show();
    const dds::ReceivedInputs received = inputs_.poll();
    EXPECT_FALSE(received.is_corrupt);
    for (const safety::OperatorInput& input : received.commands()) {
      commands_.push_back(input.command);
      shown_ = gate_.command(input.command, input.stop_id);
    }
  }
  /// One command by a process of its own, as a person would give it; the mode afterwards.
  Mode send(const std::string& command) {
    ChildProcess process = start({"operator", "--command", command, "--timeout", "60"});
    const std::size_t before = commands_.size();
    EXPECT_TRUE(dds::eventually([&] {
      serve();
      return commands_.size() > before;
    }));
    EXPECT_EQ(process.wait(kPatience), 0) << content(log_);
    // The next process is another source, which may take over when this one has been silent.
    const auto t_free = dds::read_clocks().monotonic + safety::ReceiverParameters{}.source_timeout;
    EXPECT_TRUE(dds::eventually([&] { return dds::read_clocks().monotonic > t_free; }));
    return shown_.mode;
  }

  dds::ProtectedWriter<msg::MotionStop> stops_{participant_, dds::random_source()};
  safety::test::GateDriver gate_;
  safety::Decision shown_;
  std::vector<Command> commands_;
};

TEST_F(OperatorProcess, EndsAStopInTwoStepsAndNoFewer) {
  ASSERT_EQ(send("stop"), Mode::stop_latched);
  const std::uint32_t stop_id = shown_.stop_id;
  EXPECT_EQ(send("arm"), Mode::stop_latched);
  EXPECT_EQ(send("confirm"), Mode::stop_latched);  // nothing to confirm
  EXPECT_EQ(send("acknowledge"), Mode::stop_latched);
  gate_.run(300ms);
  EXPECT_EQ(send("confirm"), Mode::ready);
  EXPECT_EQ(shown_.stop_id, stop_id);
  EXPECT_EQ(send("arm"), Mode::permitted);
}

TEST_F(OperatorProcess, ConfirmsInVainBeforeTheWindowAndAfterIt) {
  ASSERT_EQ(send("stop"), Mode::stop_latched);
  for (const auto wait : {std::chrono::milliseconds(100), std::chrono::milliseconds(10'100)}) {
    EXPECT_EQ(send("acknowledge"), Mode::stop_latched);
    gate_.run(wait);
    EXPECT_EQ(send("confirm"), Mode::stop_latched) << wait.count() << " ms";
  }
}

TEST_F(OperatorProcess, AutomaticOneAcknowledgesConfirmsAndArms) {
  ASSERT_EQ(send("stop"), Mode::stop_latched);
  commands_.clear();
  ChildProcess process = start({"operator", "--auto", "--reaction-ms", "0"});
  auto then = dds::read_clocks().monotonic;
  ASSERT_TRUE(dds::eventually([&] {
    const auto now = dds::read_clocks().monotonic;
    shown_ = gate_.step({}, std::max(now - then, std::chrono::nanoseconds(1)));  // real time here
    then = now;
    serve();
    return shown_.mode == Mode::permitted;
  }));
  EXPECT_EQ(process.end(kPatience), 0) << content(log_);
  ASSERT_GE(commands_.size(), 3U);
  EXPECT_EQ(std::vector(commands_.end() - 3, commands_.end()),
            (std::vector{Command::acknowledge, Command::confirm, Command::arm}));
}

TEST_F(OperatorProcess, SaysThatThereIsNoDaemon) {
  ChildProcess process = start({"operator", "--command", "stop", "--timeout", "0.2"});
  EXPECT_EQ(process.wait(kPatience), 3) << content(log_);
  EXPECT_NE(content(log_).find("no daemon on domain"), std::string::npos) << content(log_);
}

class RobotProcess : public RoomTest {
 protected:
  /// The newest status that passed the daemon's checks.
  bool has_fault() {
    if (const auto received = inputs_.poll().robot) has_fault_ = received->has_fault;
    return has_fault_;
  }
  bool is_enabled() {
    for (const msg::RobotStatus& status : statuses_.take()) is_enabled_ = status.is_enabled;
    return is_enabled_;
  }
  dds::ScriptedDaemon daemon_{participant_};
  dds::Reader<msg::RobotStatus> statuses_{participant_};
  bool has_fault_ = false, is_enabled_ = false;
};

TEST_F(RobotProcess, ActsWhilePermittedAndWritesItDown) {
  const fs::path csv = folder_ / "robot.csv";
  ChildProcess process = start({"robot", "--log", csv.string(), "--json"});
  ASSERT_TRUE(dds::eventually([&] {
    daemon_.permit();
    return is_enabled();
  }));
  ASSERT_TRUE(dds::eventually([&] {
    daemon_.stop();
    return !is_enabled();
  }));
  EXPECT_EQ(process.end(kPatience), 0) << content(log_);

  const nlohmann::json summary = result();
  EXPECT_GE(summary["permissions"], 1);
  EXPECT_GE(summary["poses_acted"], 1);
  EXPECT_EQ(summary["qos_mismatches"], nlohmann::json::array());
  const std::string rows = content(csv);
  EXPECT_LT(rows.find("\npermitted,"), rows.find("\npose,"));
  EXPECT_LT(rows.find("\npose,"), rows.find("\nstopped,"));
  EXPECT_NE(rows.find("\nstopped,"), std::string::npos);
}

TEST_F(RobotProcess, DoesNotActWithAFaultOfItsOwnAndReportsIt) {
  ChildProcess process = start({"robot", "--fault-at", "0", "--json"});
  ASSERT_TRUE(dds::eventually([&] {
    daemon_.permit();
    return has_fault();
  }));
  for (int i = 0; i < 20; ++i) {
    daemon_.permit();
    EXPECT_FALSE(is_enabled());
  }
  EXPECT_EQ(process.end(kPatience), 0) << content(log_);
  EXPECT_EQ(result()["permissions"], 0);
}

}  // namespace
}  // namespace holdfast::sim
