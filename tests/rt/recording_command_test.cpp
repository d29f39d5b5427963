// SPDX-License-Identifier: Apache-2.0
// Recordings as users meet them: a recording process that is killed, the `holdfast replay` program,
// and the official MCAP reader on the same files.
#include <algorithm>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <map>
#include <sstream>
#include <string>
#include <thread>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <sched.h>
#include <sys/mount.h>
#include <sys/wait.h>
#include <unistd.h>

#include "bridge/recorder/segment_folder.hpp"
#include "rt/core/clock.hpp"
#include "rt/decision_table.hpp"
#include "rt/recorder.hpp"
#include "tests/rt/recorded_day.hpp"

namespace holdfast::rt {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

struct Outcome {
  int code = -1;
  std::string out, err;
};

class RecordingCommand : public ::testing::Test {
 protected:
  void SetUp() override { fs::create_directories(folder_); }
  void TearDown() override {
    (void)::umount2((folder_ / "disk").c_str(), MNT_DETACH);  // where one was mounted
    fs::remove_all(folder_);
  }

  static std::string content(const fs::path& file) {
    std::stringstream text;
    text << std::ifstream(file).rdbuf();
    return text.str();
  }
  [[nodiscard]] Outcome run(const std::string& command) const {
    const fs::path out = folder_ / "out.txt";
    const fs::path err = folder_ / "err.txt";
    const int status = std::system(
        (command + " >'" + out.string() + "' 2>'" + err.string() + "' </dev/null").c_str());
    return {WIFEXITED(status) ? WEXITSTATUS(status) : -1, content(out), content(err)};
  }
  [[nodiscard]] Outcome replay_program(const fs::path& source, const std::string& more = "") const {
    return run("'" HOLDFAST_PROGRAM "' replay '" + source.string() + "' " + more);
  }
  /// What the official reader finds; a failure is its one line.
  [[nodiscard]] json official(const fs::path& file, const std::string& cycle = "") const {
    const Outcome outcome =
        run("NODE_PATH='" HOLDFAST_NODE_MODULES "' node '" HOLDFAST_MCAP_READER "' '" +
            file.string() + "' " + cycle);
    EXPECT_EQ(outcome.code, 0) << outcome.err << "`./dev setup` installs what it needs";
    return outcome.code == 0 ? json::parse(outcome.out) : json();
  }
  void expect_refused(const fs::path& source, int code, const std::string& part_of_the_line) const {
    const Outcome outcome = replay_program(source);
    EXPECT_EQ(outcome.code, code) << outcome.err;
    EXPECT_EQ(std::count(outcome.err.begin(), outcome.err.end(), '\n'), 1) << outcome.err;
    EXPECT_NE(outcome.err.find(part_of_the_line), std::string::npos) << outcome.err;
  }
  /// `cycles` of a virtual day in folder_/recordings, closed.
  [[nodiscard]] fs::path recorded_day(std::uint64_t cycles) const {
    testing::RecordedDay day;
    {
      Recorder recorder({folder_ / "recordings"}, testing::day_session());
      while (day.cycles() < cycles) day.record(recorder.tape());
    }
    return bridge::recordings_in(folder_ / "recordings").front();
  }

  fs::path folder_ = fs::path(::testing::TempDir()) /
                     ("recording-" + std::to_string(getpid()) + "-" +
                      ::testing::UnitTest::GetInstance()->current_test_info()->name());
};

TEST_F(RecordingCommand, AKilledRecorderLeavesAFileThatReplaysUpToTheLastSecond) {
  RecordProperty("requirement", "SR-122");
  constexpr std::uint64_t kCycles = 3000;
  std::array<int, 2> pipe{};
  ASSERT_EQ(::pipe(pipe.data()), 0);
  const pid_t child = ::fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    testing::RecordedDay day;
    Recorder recorder({folder_ / "recordings"}, testing::day_session());
    for (safety::Timestamp next = monotonic_now();; next += std::chrono::milliseconds(1)) {
      std::this_thread::sleep_for(next - monotonic_now());  // the loop's pace
      day.record(recorder.tape());
      if (day.cycles() == kCycles) (void)!::write(pipe[1], "x", 1);
    }
  }
  char byte = 0;
  EXPECT_EQ(::read(pipe[0], &byte, 1), 1);
  ::kill(child, SIGKILL);
  ::waitpid(child, nullptr, 0);
  ::close(pipe[0]);
  ::close(pipe[1]);

  const Outcome outcome = replay_program(folder_ / "recordings", "--json");
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  const json result = json::parse(outcome.out);
  EXPECT_EQ(result["differences"], 0);
  EXPECT_EQ(result["decisions_compared"], result["cycles"]);
  EXPECT_GE(result["cycles"], kCycles - 1000);
  EXPECT_EQ(result["cut_off"].size(), 1U);
  const json seen = official(bridge::recordings_in(folder_ / "recordings").front());
  EXPECT_EQ(seen["topics"]["/holdfast/decision"], result["cycles"]);
  EXPECT_TRUE(seen["indexed"].is_null());
}

TEST_F(RecordingCommand, TheOfficialReaderFindsEveryMessageAndItsValues) {
  constexpr std::uint64_t kCycles = 2500;
  const fs::path file = recorded_day(kCycles);
  const json seen = official(file, "1700");
  EXPECT_EQ(seen["topics"]["/holdfast/input"], kCycles);
  EXPECT_EQ(seen["topics"]["/holdfast/decision"], kCycles);
  EXPECT_EQ(seen["indexed"]["counts"], seen["topics"]);
  EXPECT_EQ(seen["encodings"]["/holdfast/state"], "cdr ros2msg holdfast_msgs/msg/State");
  json statistics = seen["indexed"]["statistics"];
  for (const char* silent : {"/holdfast/gap"}) statistics.erase(silent);
  EXPECT_EQ(statistics, seen["topics"]);
  // The same cycle's values, by our own step.
  testing::RecordedDay day;
  for (std::uint64_t i = 0; i <= 1700; ++i)
    day.cycle([&](const CycleInfo& info, safety::Timestamp now, const Readings& readings,
                  const ControlOutput& output, const ControlState& /*state*/) {
      if (info.index != 1700) return;
      const json& input = seen["input"];
      const json& decision = seen["decision"];
      EXPECT_EQ(input["t_decided_ns"], std::to_string(now.count()));
      EXPECT_EQ(input["readings"]["loop"]["wake_lateness_ns"],
                std::to_string(readings.loop.wake_lateness.count()));
      EXPECT_EQ(decision["mode"], static_cast<int>(safety::Mode::permitted));
      EXPECT_EQ(decision["reasons"], std::to_string(output.decision.reasons.bits()));
      EXPECT_EQ(std::stod(decision["sigma_target_mm"].get<std::string>()), output.sigma_target_mm);
      const auto& T = output.decision.approved->T_robot_ct().matrix();
      const json& recorded = decision["approved"][0]["transform_robot_ct"];
      for (int row = 0; row < 4; ++row)
        for (int col = 0; col < 4; ++col)
          EXPECT_EQ(std::stod(recorded[static_cast<std::size_t>(row * 4 + col)].get<std::string>()),
                    T(row, col));
    });
  EXPECT_EQ(std::stod(seen["session"]["zoom"].get<std::string>()), 1.3);
  EXPECT_EQ(
      std::stod(seen["session"]["parameters"]["limits"]["sigma_target_max_mm"].get<std::string>()),
      safety::Limits{}.sigma_target_max_mm);
}

/// A file system of `size`, for this process and its children alone; false where the system does
/// not let one be made.
bool mount_small_disk(const fs::path& folder, const char* size) {
  fs::create_directories(folder);
  if (::unshare(::geteuid() == 0 ? CLONE_NEWNS : CLONE_NEWNS | CLONE_NEWUSER) != 0) return false;
  if (::mount("none", "/", nullptr, MS_REC | MS_PRIVATE, nullptr) != 0) return false;
  const std::string options = std::string("size=") + size;
  return ::mount("holdfast", folder.c_str(), "tmpfs", 0, options.c_str()) == 0;
}

/// Takes every byte that is left on its file system.
void fill(const fs::path& ballast) {
  std::ofstream file(ballast, std::ios::app | std::ios::binary);
  while (file << std::string(4096, 'x') << std::flush) {
  }
}

TEST_F(RecordingCommand, ADiskThatIsTrulyFullCostsOldAndThenNewCyclesAndNothingElse) {
  const fs::path disk = folder_ / "disk";
  if (!mount_small_disk(disk, "8m"))
    GTEST_SKIP() << "no mount of one's own here: " << std::strerror(errno);
  RecordProperty("requirement", "SR-121");
  testing::RecordedDay day;
  std::uint64_t lost = 0;
  {
    Recorder recorder({disk}, testing::day_session());
    const auto record = [&](std::uint64_t cycles) {
      for (std::uint64_t i = 0; i < cycles; ++i) day.record(recorder.tape());
      while (recorder.status().taken < day.cycles()) std::this_thread::yield();
    };
    record(1500);
    EXPECT_EQ(recorder.status().condition, RecorderCondition::recording);
    // Somebody else takes the disk, also what the recorder gives up of its own.
    bool is_named = false;
    for (int i = 0; i < 100 && recorder.status().lost < 1000; ++i) {
      fill(disk / "ballast");
      record(100);
      is_named = is_named || recorder.status().condition == RecorderCondition::disk_full;
    }
    EXPECT_TRUE(is_named);
    EXPECT_GE(recorder.status().lost, 1000U);
    fs::remove(disk / "ballast");
    record(2500);
    EXPECT_EQ(recorder.status().condition, RecorderCondition::recording);
    lost = recorder.status().lost;
    record(500);
    EXPECT_EQ(recorder.status().lost, lost);
  }
  const Outcome outcome = replay_program(disk, "--json");
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  const json result = json::parse(outcome.out);
  EXPECT_EQ(result["differences"], 0);
  EXPECT_EQ(result["decisions_compared"], result["cycles"]) << "it resumes with a state";
  EXPECT_GE(result["cycles"], 1500U);
  EXPECT_LE(result["cycles"].get<std::uint64_t>() + lost, day.cycles());
  std::uint64_t read = 0;
  for (const fs::path& file : bridge::recordings_in(disk))
    read += official(file)["topics"].value("/holdfast/decision", std::uint64_t{0});
  EXPECT_EQ(read, result["cycles"]);
}

TEST_F(RecordingCommand, TheTableHoldsEachDecisionAndAppearsOnlyWhenAllCameOutAgain) {
  constexpr std::uint64_t kCycles = 2500;
  const fs::path file = recorded_day(kCycles);
  const fs::path csv = folder_ / "decisions.csv";
  ASSERT_EQ(replay_program(file, "--csv '" + csv.string() + "'").code, 0);
  std::string expected = decision_table_header();
  std::uint64_t approved = 0;
  ControlOutput at_1700;
  testing::RecordedDay day;
  for (std::uint64_t i = 0; i < kCycles; ++i)
    day.cycle([&](const CycleInfo& info, safety::Timestamp now, const Readings& /*readings*/,
                  const ControlOutput& output, const ControlState& /*state*/) {
      RecordedInput input;
      input.cycle = info.index;
      input.t_decided = now;
      append_decision_row(expected, input, output);
      approved += output.decision.approved ? 1U : 0U;
      if (info.index == 1700) at_1700 = output;
    });
  EXPECT_GT(approved, 100U);
  EXPECT_TRUE(content(csv) == expected);  // not EXPECT_EQ: half a megabyte

  // Row 1700, its columns by name: permitted, a pose whose numbers read back to the same bits.
  std::istringstream rows(expected);
  std::string header, row;
  std::getline(rows, header);
  for (int i = 0; i <= 1700; ++i) std::getline(rows, row);
  std::map<std::string, std::string> value;
  std::istringstream names(header), values(row);
  for (std::string name, text; std::getline(names, name, ',');) {
    std::getline(values, text, ',');
    value[name] = text;
  }
  EXPECT_EQ(value["cycle"], "1700");
  EXPECT_EQ(value["mode"], "permitted");
  EXPECT_EQ(value["cause"], "none");
  EXPECT_EQ(value["reasons"], "");
  EXPECT_EQ(value["is_approved"], "1");
  EXPECT_EQ(std::stod(value["sigma_target_mm"]), at_1700.sigma_target_mm);
  const auto& T = at_1700.decision.approved->T_robot_ct();
  EXPECT_EQ(std::stod(value["ty_mm"]), T.translation().y());
  EXPECT_EQ(std::stod(value["qw"]), Eigen::Quaterniond(T.linear()).w());

  fs::remove(csv);
  std::ofstream(folder_ / "bad.mcap") << "a text";
  EXPECT_EQ(replay_program(folder_ / "bad.mcap", "--csv '" + csv.string() + "'").code, 2);
  EXPECT_FALSE(fs::exists(csv));
}

TEST_F(RecordingCommand, BadInputIsOneLineAndTheRightCode) {
  const fs::path file = recorded_day(1200);
  EXPECT_EQ(replay_program(file).code, 0);
  const std::string bytes = content(file);
  const fs::path bad = folder_ / "bad.mcap";
  const auto write = [&](const std::string& changed) {
    std::ofstream(bad, std::ios::binary | std::ios::trunc) << changed;
  };
  expect_refused(folder_ / "nowhere.mcap", 2, "nowhere.mcap: cannot be read");
  expect_refused(folder_, 2, "holds no recording");
  write("a text");
  expect_refused(bad, 2, "bad.mcap: not an MCAP file");
  write("");
  expect_refused(bad, 1, "no decision to compare");
  std::string flipped = bytes;
  flipped[flipped.size() / 2] = static_cast<char>(flipped[flipped.size() / 2] ^ 4);
  write(flipped);
  expect_refused(bad, 2, "does not match");
  write(bytes.substr(0, bytes.size() / 4 * 3));  // beyond the first chunk
  const Outcome cut = replay_program(bad, "--json");
  EXPECT_EQ(cut.code, 0) << cut.err;
  EXPECT_EQ(json::parse(cut.out)["cut_off"].size(), 1U);
  EXPECT_EQ(run("'" HOLDFAST_PROGRAM "' replay").code, 2);
}

}  // namespace
}  // namespace holdfast::rt
