// SPDX-License-Identifier: Apache-2.0
// holdfast-bench-loop: the control loop at 1 kHz on this machine under load, with cyclictest on the
// same CPU, and two empty cyclic threads as witnesses: a slot missed by the loop while a witness
// was held up too is the machine's own; one that no witness shares would be ours.
#include <csignal>
#include <cstdio>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include "bridge/atomic_file.hpp"
#include "bridge/command_line.hpp"
#include "rt/core/cyclic_thread.hpp"
#include "rt/core/error.hpp"
#include "rt/core/memory_lock.hpp"
#include "tests/rt/rt_path.hpp"

namespace holdfast::rt {
namespace {

using std::chrono::microseconds;
using std::chrono::nanoseconds;

struct Options {
  int seconds = 60;
  int load = 2;
  int cpu = 0;
  int priority = 80;
  bool allow_non_rt = false;
  std::string json;
};

double us(nanoseconds time) {
  return std::chrono::duration<double, std::micro>(time).count();
}

/// Processes that keep the CPUs and the memory bus busy for as long as this lives.
class Load {
 public:
  explicit Load(int workers) {
    const pid_t parent = getpid();
    for (int i = 0; i < workers; ++i) {
      const pid_t child = fork();
      if (child < 0) throw UnavailableError("load: fork denied");
      if (child == 0) work(parent);
      children_.push_back(child);
    }
  }
  ~Load() {
    for (const pid_t child : children_) kill(child, SIGKILL);
    for (const pid_t child : children_) waitpid(child, nullptr, 0);
  }
  Load(const Load&) = delete;
  Load& operator=(const Load&) = delete;

 private:
  [[noreturn]] static void work(pid_t parent) {
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    std::vector<std::uint64_t> memory(8 * 1024 * 1024);  // 64 MiB: larger than the caches
    for (std::uint64_t round = 0; getppid() == parent; ++round) {
      for (std::size_t i = 0; i < memory.size(); i += 8) memory[i] += round ^ i;
    }
    _exit(static_cast<int>(memory[0] & 1));
  }
  std::vector<pid_t> children_;
};

/// cyclictest beside the loop: same CPU, one priority below, so that it does not disturb the loop.
class CyclicTest {
 public:
  explicit CyclicTest(const Options& options)
      : pipe_(popen(fmt::format("exec cyclictest -q -m -t 1 -a {} -p {} -i 1000 -D {} 2>&1",
                                options.cpu, options.priority - 1, options.seconds)
                        .c_str(),
                    "r")) {
    if (pipe_ == nullptr) throw UnavailableError("cyclictest: popen denied");
  }
  ~CyclicTest() {
    if (pipe_ != nullptr) pclose(pipe_);
  }
  CyclicTest(const CyclicTest&) = delete;
  CyclicTest& operator=(const CyclicTest&) = delete;

  /// Waits for its end. Microseconds.
  [[nodiscard]] nlohmann::json result() {
    std::string text;
    char line[512];
    while (std::fgets(line, sizeof(line), pipe_) != nullptr) text += line;
    pclose(pipe_);
    pipe_ = nullptr;
    const auto begin = text.find("Min:");
    int min = 0;
    int act = 0;
    int avg = 0;
    int max = 0;
    if (begin == std::string::npos ||
        std::sscanf(text.c_str() + begin, "Min:%d Act:%d Avg:%d Max:%d", &min, &act, &avg, &max) !=
            4) {
      throw UnavailableError("cyclictest: no result; apt-get install rt-tests");
    }
    return {{"min_us", min}, {"avg_us", avg}, {"max_us", max}};
  }

 private:
  FILE* pipe_;
};

/// When a thread was held up: it should have run at `from` and did at `to`.
struct Gap {
  nanoseconds from{}, to{};
};

/// What one cyclic thread saw. Filled on its thread, read after its end.
struct Record {
  static constexpr nanoseconds kGapMin = microseconds(200);
  LatencyHistogram lateness;
  std::vector<Gap> gaps;
  std::uint64_t cycles = 0, missed = 0;

  Record() { gaps.reserve(1 << 16); }
  void note(const CycleInfo& info) noexcept {
    lateness.record(info.lateness);
    if (info.lateness >= kGapMin && gaps.size() < gaps.capacity()) {
      gaps.push_back({info.t_scheduled, info.t_woken});
    }
    cycles = info.index + 1;
    missed = info.missed;
  }
  [[nodiscard]] bool was_held_up(const Gap& gap) const {
    for (const Gap& own : gaps) {
      if (own.from < gap.to && gap.from < own.to) return true;
    }
    return false;
  }
};

CyclicThreadParameters thread_parameters(const Options& options) {
  CyclicThreadParameters parameters;
  parameters.cpu = options.cpu;
  parameters.fifo_priority = options.priority;
  parameters.allow_non_rt = options.allow_non_rt;
  return parameters;
}

struct Run {
  Record loop, same_cpu, other_cpu;
  std::vector<Gap> missed;  ///< gaps of the loop in which a slot was missed
  testing::RtPath path;
  std::vector<std::string> warnings;
};

/// The threads run until cyclictest has ended.
nlohmann::json run_threads(const Options& options, Run& run) {
  testing::VirtualInputs inputs;
  std::optional<nanoseconds> t_first;
  run.missed.reserve(1 << 16);
  const auto cycle = [&](const CycleInfo& info) {
    const bool is_missed = info.missed > run.loop.missed;
    run.loop.note(info);
    if (is_missed && run.missed.size() < run.missed.capacity()) {
      run.missed.push_back({info.t_scheduled, info.t_woken});
    }
    if (!t_first) t_first = info.t_woken;
    const safety::Timestamp now = testing::kStart + (info.t_woken - *t_first);
    Readings readings = inputs.at(now);
    if (info.index == 1000) readings.operator_command.command = safety::Command::arm;
    run.path.deliver(readings);
    run.path.cycle(now);
  };
  CyclicThreadParameters parameters = thread_parameters(options);
  CyclicTest cyclictest(options);
  parameters.name = "control";
  CyclicThread control(parameters, cycle);
  run.warnings.insert(run.warnings.end(), control.warnings().begin(), control.warnings().end());
  // Above the loop: whatever the loop's own work does, it cannot hold up this witness.
  parameters.name = "witness";
  parameters.phase = microseconds(500);
  parameters.fifo_priority = options.priority + 1;
  CyclicThread same(parameters, [&](const CycleInfo& info) { run.same_cpu.note(info); });
  parameters.phase = {};
  parameters.cpu = options.cpu == 0 ? 1 : 0;
  CyclicThread other(parameters, [&](const CycleInfo& info) { run.other_cpu.note(info); });
  nlohmann::json result = cyclictest.result();
  control.stop();
  same.stop();
  other.stop();
  return result;
}

nlohmann::json summary(const Record& record) {
  const LatencySnapshot lateness = record.lateness.snapshot();
  return {{"cycles", record.cycles},
          {"missed", record.missed},
          {"lateness_p50_us", us(lateness.percentile(0.5))},
          {"lateness_p99_us", us(lateness.percentile(0.99))},
          {"lateness_p999_us", us(lateness.percentile(0.999))},
          {"lateness_max_us", us(lateness.max())}};
}

nlohmann::json report(const Options& options, const Run& run, const nlohmann::json& cyclictest) {
  std::size_t both = 0;
  for (const Gap& gap : run.missed) {
    if (run.same_cpu.was_held_up(gap) || run.other_cpu.was_held_up(gap)) ++both;
  }
  const LatencySnapshot step = run.path.step_time.snapshot();
  nlohmann::json loop = summary(run.loop);
  loop.update({{"name", "control loop, wake-up lateness"},
               {"median", loop["lateness_p50_us"]},
               {"p99", loop["lateness_p99_us"]},
               {"unit", "us"},
               {"seconds", options.seconds},
               {"load", options.load},
               {"gaps", run.missed.size()},
               {"gaps_shared_with_a_witness", both},
               {"gaps_of_our_own", run.missed.size() - both},
               {"cyclictest", cyclictest},
               {"witness_same_cpu", summary(run.same_cpu)},
               {"witness_other_cpu", summary(run.other_cpu)},
               {"warnings", run.warnings}});
  return nlohmann::json::array({loop,
                                {{"name", "control step"},
                                 {"median", us(step.percentile(0.5))},
                                 {"p99", us(step.percentile(0.99))},
                                 {"max", us(step.max())},
                                 {"unit", "us"}}});
}

void bench(const Options& options) {
  const Load load(options.load);  // before the memory lock, so that the workers are ordinary
  const auto run = std::make_unique<Run>();
  run->warnings = lock_memory({.allow_non_rt = options.allow_non_rt});
  const nlohmann::json cyclictest = run_threads(options, *run);
  const nlohmann::json results = report(options, *run, cyclictest);
  std::puts(results.dump(2).c_str());
  if (options.json.empty()) return;
  bridge::write_file_atomically(options.json, results.dump(2) + "\n");
}

}  // namespace
}  // namespace holdfast::rt

int main(int argc, char** argv) {
  CLI::App app{
      "The control loop at 1 kHz under load, beside cyclictest and two empty threads.\n"
      "Example: holdfast-bench-loop --seconds 60 --load 2 --json loop.json",
      "holdfast-bench-loop"};
  holdfast::rt::Options options;
  app.add_option("--seconds", options.seconds)->check(CLI::Range(1, 86400))->capture_default_str();
  app.add_option("--load", options.load, "busy processes with memory traffic")
      ->check(CLI::Range(0, 1024))
      ->capture_default_str();
  app.add_option("--cpu", options.cpu, "of the loop")->check(CLI::Range(0, 1023));
  app.add_option("--priority", options.priority, "SCHED_FIFO")
      ->check(CLI::Range(2, 98))
      ->capture_default_str();
  app.add_flag("--allow-non-rt", options.allow_non_rt, "go on without real-time scheduling");
  app.add_option("--json", options.json, "results as a JSON list");
  app.callback([&options] { holdfast::rt::bench(options); });
  return holdfast::bridge::run_command_line(app, argc, argv);
}
