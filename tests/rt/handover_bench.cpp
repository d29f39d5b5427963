// SPDX-License-Identifier: Apache-2.0
// holdfast-bench-handover: decisions from one thread to another as the control loop hands them to
// the publisher (mailbox, and stop latch beside it), as fast as both can: none torn, none going
// back, no stop behind a later permission. The baseline hands the same values over under a mutex.
#include <algorithm>
#include <array>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <mutex>
#include <string>
#include <thread>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "bridge/atomic_file.hpp"
#include "bridge/command_line.hpp"
#include "rt/core/error.hpp"
#include "rt/core/mailbox.hpp"
#include "rt/core/stop_latch.hpp"

namespace holdfast::rt {
namespace {

constexpr std::uint64_t kStopEvery = 7;

/// Every word holds the cycle, so a torn copy shows.
struct Report {
  std::array<std::uint64_t, 8> cycle{};
  Report() = default;
  explicit Report(std::uint64_t c) { cycle.fill(c); }
  [[nodiscard]] bool is_torn() const {
    std::uint64_t differences = 0;
    for (const std::uint64_t word : cycle) differences |= word ^ cycle[0];
    return differences != 0;
  }
};

struct Faults {
  std::uint64_t torn = 0, backwards = 0, stops_behind = 0;
};

/// What a mutex would make of it.
class LockedMailbox {
 public:
  void publish(const Report& report) {
    const std::lock_guard lock(mutex_);
    report_ = report;
    is_fresh_ = true;
  }
  bool try_take(Report& report) {
    const std::lock_guard lock(mutex_);
    if (!is_fresh_) return false;
    is_fresh_ = false;
    report = report_;
    return true;
  }

 private:
  std::mutex mutex_;
  Report report_;
  bool is_fresh_ = false;
};

/// ns for each decision, by the deciding thread's clock.
template <typename AnyMailbox>
double exchange(std::uint64_t count, Faults& faults) {
  AnyMailbox mailbox;
  StopLatch latch;
  std::chrono::duration<double, std::nano> took{};
  std::thread decider([&] {
    const auto start = std::chrono::steady_clock::now();
    for (std::uint64_t cycle = 1; cycle <= count; ++cycle) {
      if (cycle % kStopEvery == 0) latch.raise(0, cycle);
      mailbox.publish(Report(cycle));
    }
    took = std::chrono::steady_clock::now() - start;
  });
  std::uint64_t stopped_until = 0;
  Report report;
  for (std::uint64_t previous = 0; previous < count; previous = report.cycle[0]) {
    while (!mailbox.try_take(report)) {
    }
    if (report.is_torn()) ++faults.torn;
    if (report.cycle[0] <= previous) ++faults.backwards;
    if (const auto stop = latch.take()) stopped_until = stop->sequence;
    // Every stop up to this report's cycle is in the latch by now.
    if (stopped_until < report.cycle[0] - report.cycle[0] % kStopEvery) ++faults.stops_behind;
  }
  decider.join();
  return took.count() / static_cast<double>(count);
}

void bench(std::uint64_t count, const std::string& file) {
  Faults faults, ignored;
  const double ours_ns = exchange<Mailbox<Report>>(count, faults);
  constexpr std::uint64_t kBaselineMost = 20'000'000;
  const double mutex_ns = exchange<LockedMailbox>(std::min(count, kBaselineMost), ignored);
  const nlohmann::json results = nlohmann::json::array({{{"name", "handover of one decision"},
                                                         {"median", ours_ns},
                                                         {"p99", nullptr},
                                                         {"unit", "ns"},
                                                         {"baseline", mutex_ns},
                                                         {"ratio", mutex_ns / ours_ns},
                                                         {"exchanges", count},
                                                         {"torn", faults.torn},
                                                         {"backwards", faults.backwards},
                                                         {"stops_behind", faults.stops_behind}}});
  std::puts(results.dump(2).c_str());
  if (!file.empty()) bridge::write_file_atomically(file, results.dump(2) + "\n");
  if (faults.torn + faults.backwards + faults.stops_behind > 0)
    throw RefusedError("a decision was torn, went back, or a stop came behind a permission");
}

}  // namespace
}  // namespace holdfast::rt

int main(int argc, char** argv) {
  CLI::App app{
      "Decisions between two threads through mailbox and stop latch, as fast as both can.\n"
      "Example: holdfast-bench-handover --exchanges 1000000000 --json handover.json\n"
      "Exit codes: 0 none torn, none back, no stop behind a permission; 1 not so.",
      "holdfast-bench-handover"};
  std::uint64_t exchanges = 1'000'000'000;
  std::string json;
  app.add_option("--exchanges", exchanges)
      ->check(CLI::Range(1'000ULL, 1'000'000'000'000ULL))
      ->capture_default_str();
  app.add_option("--json", json, "results as a JSON list");
  app.callback([&] { holdfast::rt::bench(exchanges, json); });
  return holdfast::bridge::run_command_line(app, argc, argv);
}
