// SPDX-License-Identifier: Apache-2.0
// `holdfast console` as a process, at a terminal (a pseudo one) and in scripts, against a real gate
// and the real wire, and against the real daemon.
#include <csignal>
#include <filesystem>
#include <fstream>
#include <sstream>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <poll.h>
#include <pty.h>
#include <sys/wait.h>
#include <unistd.h>

#include "bridge/dds/inputs.hpp"
#include "bridge/dds/messages.hpp"
#include "tests/bridge/dds_domain.hpp"
#include "tests/safety/good_inputs.hpp"
#include "tests/sim/demo/rig.hpp"

namespace holdfast::console {
namespace {

using namespace std::chrono_literals;
namespace dds = bridge::dds;
namespace fs = std::filesystem;
using safety::Command;
using safety::Mode;

/// `holdfast console` at a terminal of its own.
class Terminal {
 public:
  explicit Terminal(std::uint32_t domain) {
    pid_ = forkpty(&master_, nullptr, nullptr, nullptr);
    if (pid_ == 0) {
      execl(HOLDFAST_PROGRAM, "holdfast", "console", "--domain", std::to_string(domain).c_str(),
            nullptr);
      _exit(127);
    }
  }
  ~Terminal() {
    if (pid_ > 0) {
      kill(pid_, SIGKILL);
      waitpid(pid_, nullptr, 0);
    }
    close(master_);
  }
  Terminal(const Terminal&) = delete;
  Terminal& operator=(const Terminal&) = delete;

  void type(const std::string& line) {
    from_ = text_.size();  // what is shown from now on
    const std::string keys = line + "\n";
    ASSERT_EQ(write(master_, keys.data(), keys.size()), static_cast<ssize_t>(keys.size()));
  }
  /// Whether `part` has been shown since the newest line was typed. Does not wait.
  bool shows(const std::string& part) {
    pollfd output{master_, POLLIN, 0};
    char buffer[1024];
    while (poll(&output, 1, 0) > 0) {
      const ssize_t n = read(master_, buffer, sizeof buffer);
      if (n <= 0) break;
      text_.append(buffer, static_cast<std::size_t>(n));
    }
    return text_.find(part, from_) != std::string::npos;
  }
  /// Its exit code once it has ended.
  std::optional<int> exit_code() {
    int status = 0;
    (void)shows("");  // a full terminal would keep it from ending
    if (pid_ <= 0 || waitpid(pid_, &status, WNOHANG) != pid_) return std::nullopt;
    pid_ = -1;
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  }
  [[nodiscard]] const std::string& text() const { return text_; }

 private:
  int master_ = -1;
  pid_t pid_ = -1;
  std::string text_;
  std::size_t from_ = 0;
};

class ConsoleProcess : public ::testing::Test {
 protected:
  void SetUp() override { fs::create_directories(folder_); }
  void TearDown() override { fs::remove_all(folder_); }
  static std::string content(const fs::path& file) {
    std::stringstream text;
    text << std::ifstream(file).rdbuf();
    return text.str();
  }
  /// `holdfast console` in a script; `meanwhile` is called until it has ended.
  template <class F>
  int script(std::vector<std::string> arguments, F&& meanwhile) {
    arguments.insert(arguments.begin(), {"console", "--domain", std::to_string(domain_)});
    fs::remove(log_);
    sim::ChildProcess process(HOLDFAST_PROGRAM, arguments, log_);
    EXPECT_TRUE(dds::eventually([&] {
      meanwhile();
      return !process.is_running();
    }));
    return process.wait(1s);
  }
  int script(const std::vector<std::string>& arguments) {
    return script(arguments, [] {});
  }

  const std::uint32_t domain_ = dds::test_domain();
  const fs::path folder_ =
      fs::temp_directory_path() / ("holdfast-console-" + std::to_string(::getpid()));
  const fs::path log_ = folder_ / "log.txt";
};

/// A daemon that is nothing but a gate with inputs in perfect order, in real time.
class ConsoleAndGate : public ConsoleProcess {
 protected:
  void SetUp() override {
    ConsoleProcess::SetUp();
    shown_ = gate_.to_permitted();
    ASSERT_EQ(shown_.mode, Mode::permitted);
  }
  void serve() {
    const auto now = dds::read_clocks().monotonic;
    shown_ = gate_.step({}, std::max(now - then_, std::chrono::nanoseconds(1)));
    then_ = now;
    const dds::ReceivedInputs received = inputs_.poll();
    EXPECT_FALSE(received.is_corrupt);
    for (const safety::OperatorInput& input : received.commands()) {
      commands_.push_back(input.command);
      shown_ = gate_.command(input.command, input.stop_id);
    }
    msg::MotionStop stop = dds::to_message(shown_, gate_.now, gate_.now);
    (void)stops_.publish(stop);
  }
  bool becomes(Mode mode) {
    return dds::eventually([&] {
      serve();
      return shown_.mode == mode;
    });
  }
  bool shows(Terminal& terminal, const std::string& part) {
    return dds::eventually([&] {
      serve();
      return terminal.shows(part);
    });
  }

  dds::Participant participant_{{.domain = domain_, .configuration = {}}};
  dds::InputReader inputs_{participant_};
  dds::ProtectedWriter<msg::MotionStop> stops_{participant_, dds::random_source()};
  safety::test::GateDriver gate_;
  safety::Decision shown_;
  std::chrono::nanoseconds then_ = dds::read_clocks().monotonic;
  std::vector<Command> commands_;
};

TEST_F(ConsoleAndGate, AtATerminalStopsEndsTheStopInTwoStepsAndArms) {
  RecordProperty("requirement", "SR-133");
  Terminal terminal(domain_);
  ASSERT_TRUE(shows(terminal, "PERMITTED")) << terminal.text();
  // A console is another source; it may speak once nobody has spoken for a while.
  const auto t_free = dds::read_clocks().monotonic + 150ms;
  ASSERT_TRUE(dds::eventually([&] {
    serve();
    return dds::read_clocks().monotonic > t_free && inputs_.operator_endpoint().matched > 0;
  }));
  terminal.type("stop");
  ASSERT_TRUE(becomes(Mode::stop_latched)) << terminal.text();
  const std::string id = std::to_string(shown_.stop_id);
  ASSERT_TRUE(shows(terminal, "STOP  The operator commanded a stop (operator_stop)"))
      << terminal.text();
  terminal.type("arm");
  ASSERT_TRUE(shows(terminal, "cannot be armed")) << terminal.text();
  terminal.type("confirm " + id);
  ASSERT_TRUE(shows(terminal, "acknowledge " + id + "` first")) << terminal.text();
  terminal.type("acknowledge " + id);
  ASSERT_TRUE(shows(terminal, "stop " + id + " acknowledged")) << terminal.text();
  const auto t_confirm = gate_.now + gate_.limits.confirm_min;
  ASSERT_TRUE(dds::eventually([&] {
    serve();
    return gate_.now > t_confirm;
  }));
  terminal.type("confirm " + id);
  ASSERT_TRUE(becomes(Mode::ready)) << terminal.text();
  ASSERT_TRUE(shows(terminal, "not armed")) << terminal.text();
  terminal.type("arm");
  ASSERT_TRUE(shows(terminal, "type `yes`")) << terminal.text();
  EXPECT_EQ(shown_.mode, Mode::ready) << "one step does not arm";
  terminal.type("yes");
  ASSERT_TRUE(becomes(Mode::permitted)) << terminal.text();
  EXPECT_EQ(commands_,
            (std::vector{Command::stop, Command::acknowledge, Command::confirm, Command::arm}));
  terminal.type("quit");
  std::optional<int> code;
  EXPECT_TRUE(dds::eventually([&] { return (code = terminal.exit_code()).has_value(); }));
  EXPECT_EQ(code, 0) << terminal.text();
}

TEST_F(ConsoleAndGate, AtATerminalShowsSilenceAsStop) {
  RecordProperty("requirement", "SR-133");
  Terminal terminal(domain_);
  ASSERT_TRUE(shows(terminal, "PERMITTED")) << terminal.text();
  terminal.type("");
  EXPECT_TRUE(dds::eventually([&] { return terminal.shows("STOP: NO DATA"); })) << terminal.text();
  terminal.type("arm");
  EXPECT_TRUE(dds::eventually([&] { return terminal.shows("nothing is heard"); }));
  EXPECT_TRUE(shows(terminal, "PERMITTED")) << "and its return";
}

TEST_F(ConsoleAndGate, InAScriptTakesBothStepsOrNone) {
  RecordProperty("requirement", "SR-133");
  const auto serving = [&] { serve(); };
  EXPECT_EQ(script({"--stop"}, serving), 0) << content(log_);
  ASSERT_EQ(shown_.mode, Mode::stop_latched);
  const std::string id = std::to_string(shown_.stop_id);
  const std::string wrong = std::to_string(shown_.stop_id + 1);
  commands_.clear();
  EXPECT_EQ(script({"--acknowledge", id}, serving), 2);
  EXPECT_EQ(script({"--confirm", id}, serving), 2);
  EXPECT_EQ(script({"--acknowledge", id, "--confirm", wrong}, serving), 2) << content(log_);
  EXPECT_EQ(script({"--arm"}, serving), 2);
  EXPECT_EQ(script({"--yes"}, serving), 2);
  EXPECT_EQ(script({}, serving), 2) << "not a terminal";
  EXPECT_NE(content(log_).find("not a terminal"), std::string::npos) << content(log_);
  EXPECT_EQ(script({"--acknowledge", wrong, "--confirm", wrong}, serving), 1) << content(log_);
  EXPECT_NE(content(log_).find("the stop that is latched now is " + id), std::string::npos);
  EXPECT_EQ(script({"--arm", "--yes"}, serving), 1) << content(log_);
  EXPECT_TRUE(commands_.empty());

  EXPECT_EQ(script({"--acknowledge", id, "--confirm", id}, serving), 0) << content(log_);
  EXPECT_EQ(shown_.mode, Mode::ready);
  EXPECT_EQ(script({"--acknowledge", id, "--confirm", id}, serving), 1) << "no stop is latched";
  EXPECT_EQ(script({"--arm", "--yes"}, serving), 0) << content(log_);
  EXPECT_EQ(shown_.mode, Mode::permitted);
  EXPECT_EQ(script({"--once", "--json"}, serving), 0) << content(log_);
  const auto state = nlohmann::json::parse(content(log_), nullptr, false);
  ASSERT_TRUE(state.is_object()) << content(log_);
  EXPECT_EQ(state["mode"], "permitted");
  EXPECT_EQ(state["is_permitted"], true);
}

TEST_F(ConsoleProcess, SaysThatThereIsNoDaemon) {
  for (const char* what : {"--once", "--stop"}) {
    EXPECT_EQ(script({what, "--timeout", "0.3"}), 3) << content(log_);
    EXPECT_NE(content(log_).find("no daemon on domain"), std::string::npos) << content(log_);
  }
}

/// The whole chain as processes, with nobody at the console but the test.
class ConsoleAndDaemon : public ConsoleProcess {
 protected:
  /// What `holdfast console --once --json` prints.
  nlohmann::json state() {
    const int code = script({"--once", "--json"});
    const auto parsed = nlohmann::json::parse(content(log_), nullptr, false);
    EXPECT_TRUE(code == 0 && parsed.is_object()) << code << ": " << content(log_);
    return parsed.is_object() ? parsed : nlohmann::json{{"mode", ""}, {"stop_id", 0}};
  }
  /// What a person does to get there: a machine shared with others stops now and then by itself.
  bool gets_permitted() {
    for (const auto end = std::chrono::steady_clock::now() + 90s;
         std::chrono::steady_clock::now() < end;) {
      const nlohmann::json now = state();
      if (now["mode"] == "permitted") return true;
      if (now["mode"] == "ready") (void)script({"--arm", "--yes"});
      const std::string id = std::to_string(now["stop_id"].get<std::uint32_t>());
      if (now["mode"] == "stop_latched") (void)script({"--acknowledge", id, "--confirm", id});
    }
    ADD_FAILURE() << state();
    return false;
  }
};

TEST_F(ConsoleAndDaemon, StopsItEndsTheStopAndArms) {
  RecordProperty("requirement", "SR-133");
  sim::RigParameters parameters;
  parameters.folder = folder_ / "rig";
  parameters.daemon_config = HOLDFAST_DEMO_CONFIG;
  parameters.guard_config = HOLDFAST_GUARD_CONFIG;
  parameters.domain = static_cast<int>(domain_);
  parameters.has_operator = false;
  const sim::Rig rig(parameters);
  ASSERT_TRUE(gets_permitted());
  EXPECT_EQ(script({"--stop"}), 0) << content(log_);
  const nlohmann::json stopped = state();
  EXPECT_EQ(stopped["mode"], "stop_latched");
  EXPECT_EQ(stopped["is_permitted"], false);
  EXPECT_TRUE(gets_permitted());
  EXPECT_GT(state()["stop_id"], 0);
}

}  // namespace
}  // namespace holdfast::console
