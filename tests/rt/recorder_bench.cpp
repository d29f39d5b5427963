// SPDX-License-Identifier: Apache-2.0
// holdfast-bench-recorder: what a recording at the loop's full rate costs its thread and the
// control thread, and how long the replay of an hour takes. Robot permitted, 30 frames a second.
#include <ctime>
#include <filesystem>
#include <string>
#include <thread>
#include <vector>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include "bridge/atomic_file.hpp"
#include "bridge/command_line.hpp"
#include "bridge/recorder/segment_folder.hpp"
#include "rt/core/clock.hpp"
#include "rt/core/error.hpp"
#include "rt/core/latency_histogram.hpp"
#include "rt/recorder.hpp"
#include "rt/replay.hpp"
#include "tests/rt/recorded_day.hpp"

namespace holdfast::rt {
namespace {

namespace fs = std::filesystem;
using std::chrono::nanoseconds;

struct Options {
  int seconds = 10;
  std::string json;
};

/// A folder that is gone at the end.
struct Folder {
  fs::path path = fs::temp_directory_path() / ("recorder-bench-" + std::to_string(getpid()));
  Folder() = default;
  ~Folder() { fs::remove_all(path); }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
};

double seconds(nanoseconds time) {
  return std::chrono::duration<double>(time).count();
}
double us(nanoseconds time) {
  return seconds(time) * 1e6;
}

/// At the loop's own rate: CPU time of the recorder's thread, and of one record() on the other.
nlohmann::json full_rate(const Options& options) {
  const Folder folder;
  testing::RecordedDay day(false);
  LatencyHistogram record_time;
  const nanoseconds process_begin = detail::read_clock(CLOCK_PROCESS_CPUTIME_ID);
  const nanoseconds thread_begin = detail::read_clock(CLOCK_THREAD_CPUTIME_ID);
  const nanoseconds begin = monotonic_now();
  std::uint64_t lost = 0;
  {
    Recorder recorder({folder.path}, testing::day_session());
    for (nanoseconds next = begin; next < begin + std::chrono::seconds(options.seconds);
         next += std::chrono::milliseconds(1)) {
      std::this_thread::sleep_for(next - monotonic_now());
      day.cycle([&](const auto&... all) {
        const nanoseconds t = monotonic_now();
        recorder.tape().record(all...);
        record_time.record(monotonic_now() - t);
      });
    }
    lost = recorder.status().lost;
  }
  const nanoseconds others = (detail::read_clock(CLOCK_PROCESS_CPUTIME_ID) - process_begin) -
                             (detail::read_clock(CLOCK_THREAD_CPUTIME_ID) - thread_begin);
  std::uint64_t bytes = 0;
  for (const fs::path& file : bridge::recordings_in(folder.path)) bytes += fs::file_size(file);
  const double wall = seconds(monotonic_now() - begin);
  const LatencySnapshot record = record_time.snapshot();
  return nlohmann::json::array({{{"name", "recorder, share of one core"},
                                 {"median", 100 * seconds(others) / wall},
                                 {"p99", nullptr},
                                 {"unit", "%"},
                                 {"mb_per_s", static_cast<double>(bytes) / 1e6 / wall},
                                 {"cycles_lost", lost}},
                                {{"name", "recorder, on the control thread"},
                                 {"median", us(record.percentile(0.5))},
                                 {"p99", us(record.percentile(0.99))},
                                 {"unit", "us"}}});
}

/// An hour's replay, from that of a part of it: no cycle depends on the length.
nlohmann::json replay_of_an_hour(const Options& options) {
  const Folder folder;
  const std::uint64_t cycles = static_cast<std::uint64_t>(options.seconds) * 30'000;
  {
    testing::RecordedDay day(false);
    Recorder recorder({folder.path}, testing::day_session());
    while (day.cycles() < cycles) {
      while (day.cycles() - recorder.status().taken >= CycleTape::kCycles)
        std::this_thread::yield();
      day.record(recorder.tape());
    }
  }
  const nanoseconds begin = monotonic_now();
  const nanoseconds cpu_begin = detail::read_clock(CLOCK_PROCESS_CPUTIME_ID);
  const ReplayReport report = replay(bridge::recordings_in(folder.path));
  const double scale = 3'600'000.0 / static_cast<double>(cycles);
  if (report.compared != cycles || report.differences != 0)
    throw RefusedError(fmt::format("replay: {} of {} compared, {} differ", report.compared, cycles,
                                   report.differences));
  return {{"name", "replay of an hour"},
          {"median", scale * seconds(monotonic_now() - begin)},
          {"p99", nullptr},
          {"unit", "s"},
          {"cpu_s", scale * seconds(detail::read_clock(CLOCK_PROCESS_CPUTIME_ID) - cpu_begin)},
          {"cycles", cycles}};
}

void bench(const Options& options) {
  nlohmann::json results = full_rate(options);
  results.push_back(replay_of_an_hour(options));
  fmt::print("{}\n", results.dump(2));
  if (!options.json.empty()) bridge::write_file_atomically(options.json, results.dump(2) + "\n");
}

}  // namespace
}  // namespace holdfast::rt

int main(int argc, char** argv) {
  CLI::App app{
      "The recorder at the loop's full rate, and the replay of what it wrote.\n"
      "Example: holdfast-bench-recorder --seconds 10 --json recorder.json",
      "holdfast-bench-recorder"};
  holdfast::rt::Options options;
  app.add_option("--seconds", options.seconds, "of recording; the replay is of 30 times that")
      ->check(CLI::Range(1, 120))
      ->capture_default_str();
  app.add_option("--json", options.json, "results as a JSON list");
  app.callback([&options] { holdfast::rt::bench(options); });
  return holdfast::bridge::run_command_line(app, argc, argv);
}
