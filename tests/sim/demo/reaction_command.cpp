// SPDX-License-Identifier: Apache-2.0
// `holdfast-sim reactions` and `holdfast-sim kills`: how fast the robot stops, over many injections
// into the whole chain. Measurements, not tests: they judge nothing but that every injection
// stopped.
#include <array>
#include <filesystem>
#include <map>
#include <memory>
#include <random>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "bridge/atomic_file.hpp"
#include "bridge/command_line.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/commands.hpp"
#include "tests/sim/demo/evaluation.hpp"
#include "tests/sim/demo/rig.hpp"

namespace holdfast::sim {
namespace {

using namespace std::chrono_literals;

struct ReactionOptions {
  RigParameters rig;
  std::string json_file;
  int runs = 200;
};

struct Fault {
  const char* name;
  const char* on;
  const char* off;  ///< empty: it passes by itself
};
constexpr std::array kFaults = {Fault{"freeze", "freeze on", "freeze off"},
                                Fault{"black", "black on", "black off"},
                                Fault{"drop", "drop 2", ""}, Fault{"corrupt", "corrupt 1", ""}};

constexpr auto kStartPatience = 60s;
constexpr auto kStopPatience = 3s;

void require_permitted(Rig& rig) {
  if (!rig.wait_permitted(kStartPatience))
    throw RefusedError(fmt::format("no permission within {} s", kStartPatience / 1s));
}

std::chrono::milliseconds random_delay(std::mt19937& random) {
  return std::chrono::milliseconds{std::uniform_int_distribution{150, 450}(random)};
}

nlohmann::json figure(const std::string& name, const std::vector<double>& values, double limit) {
  return {{"name", name},
          {"median", percentile(values, 0.5)},
          {"p99", percentile(values, 0.99)},
          {"p999", percentile(values, 0.999)},
          {"max", percentile(values, 1)},
          {"n", values.size()},
          {"limit", limit},
          {"within_limit",
           std::count_if(values.begin(), values.end(), [limit](double v) { return v <= limit; })},
          {"unit", "ms"},
          {"baseline", nullptr},
          {"ratio", nullptr}};
}

void write(const ReactionOptions& options, const nlohmann::json& figures) {
  if (!options.json_file.empty())
    bridge::write_file_atomically(options.json_file, figures.dump(1) + "\n");
  for (const auto& f : figures)
    fmt::print(
        "{:<28} n {:>4}  median {:.2f}  p99 {:.2f}  p99.9 {:.2f}  max {:.2f} ms; within {:.1f} ms: "
        "{}\n",
        f["name"].get<std::string>(), f["n"].get<int>(), f["median"].get<double>(),
        f["p99"].get<double>(), f["p999"].get<double>(), f["max"].get<double>(),
        f["limit"].get<double>(), f["within_limit"].get<int>());
}

Evaluation finish_and_evaluate(Rig& rig, const std::vector<ExpectedStop>& expected) {
  rig.finish();
  return evaluate(rig.config(), rig.truth_file(), rig.events_file(), rig.robot_file(), expected,
                  rig.tracker_us(), HazardLimits{});
}

void measure_reactions(const ReactionOptions& options) {
  bridge::catch_interrupts();
  Rig rig{options.rig};
  std::mt19937 random{static_cast<std::mt19937::result_type>(options.rig.seed)};
  std::vector<ExpectedStop> expected;
  require_permitted(rig);
  for (int run = 0; run < options.runs; ++run) {
    const Fault& fault = kFaults[static_cast<std::size_t>(run) % kFaults.size()];
    rig.run_for(random_delay(random));
    require_permitted(rig);
    ExpectedStop window{fault.name, rig.inject(fault.on), {}};
    if (!rig.wait_withdrawn(kStopPatience))
      throw RefusedError(fmt::format("run {}: '{}' did not withdraw permission within {} s", run,
                                     fault.name, kStopPatience / 1s));
    if (*fault.off != '\0') (void)rig.inject(fault.off);
    require_permitted(rig);
    window.to = window.from + kStopPatience;
    expected.push_back(window);
    if ((run + 1) % 20 == 0) fmt::print(stderr, "  {} of {}\n", run + 1, options.runs);
  }
  const Evaluation evaluation = finish_and_evaluate(rig, expected);
  std::map<std::string, std::vector<double>> by_fault;
  for (const StopRecord& stop : evaluation.stops) {
    if (stop.expected.empty() || !std::isfinite(stop.reaction_ms)) continue;
    by_fault["reaction/" + stop.expected].push_back(stop.reaction_ms);
    by_fault["reaction/all"].push_back(stop.reaction_ms);
  }
  // Three loop periods, and one DDS hop as docs/dds.md measures it.
  const double limit_ms = 3 * static_cast<double>(rig.config().loop.period.count()) * 1e-6 + 0.1;
  nlohmann::json figures = nlohmann::json::array();
  for (const auto& [name, values] : by_fault) figures.push_back(figure(name, values, limit_ms));
  figures.push_back(figure("latency/exposure to robot", evaluation.latency_ms, 50));
  figures.push_back(figure("latency/arrival to robot less tracker", evaluation.handover_ms, 2));
  fmt::print("hazards {}, false stops {}, tracking rms {:.2f} um\n", evaluation.hazards,
             evaluation.false_stops, evaluation.tracking_rms_um);
  write(options, figures);
}

/// `count` kills of one rig's daemon: for each that fell while the robot was permitted, how long it
/// still was, in ms. A robot that had already stopped when the daemon was killed has nothing to
/// show.
std::vector<double> kill_daemons(const RigParameters& parameters, std::mt19937& random, int count) {
  Rig rig{parameters};
  std::vector<ExpectedStop> expected;
  for (int run = 0; run < count; ++run) {
    require_permitted(rig);
    rig.run_for(random_delay(random));
    require_permitted(rig);
    const auto t_kill = rig.kill_daemon();
    expected.push_back({"kill", t_kill, t_kill + 500ms});
    rig.restart_daemon();
    if ((run + 1) % 10 == 0) fmt::print(stderr, "  {} of {}\n", run + 1, count);
  }
  require_permitted(rig);
  const Evaluation evaluation = finish_and_evaluate(rig, expected);
  std::vector<double> still_permitted_ms;
  for (const ExpectedStop& kill : expected)
    for (const Evaluation::Interval& permission : evaluation.permissions)
      if (permission.from <= kill.from && kill.from < permission.to)
        still_permitted_ms.push_back(static_cast<double>((permission.to - kill.from).count()) *
                                     1e-6);
  return still_permitted_ms;
}

void measure_kills(const ReactionOptions& options) {
  bridge::catch_interrupts();
  std::mt19937 random{static_cast<std::mt19937::result_type>(options.rig.seed)};
  constexpr int kRounds = 5;
  const auto wanted = static_cast<std::size_t>(options.runs);
  std::vector<double> after_kill;
  int kills = 0;
  for (int round = 0; round < kRounds && after_kill.size() < wanted; ++round) {
    const auto missing = static_cast<int>(wanted - after_kill.size());
    const auto more = kill_daemons(options.rig, random, missing);
    after_kill.insert(after_kill.end(), more.begin(), more.end());
    kills += missing;
  }
  fmt::print("{} kills, {} of them while the robot was permitted\n", kills, after_kill.size());
  if (after_kill.size() < wanted)
    throw RefusedError(fmt::format("{} of {} kills came while the robot was permitted, {} wanted",
                                   after_kill.size(), kills, wanted));
  constexpr double kLimitMs = 20;
  if (percentile(after_kill, 1) > kLimitMs)
    throw RefusedError(
        fmt::format("the robot was permitted for {:.1f} ms after a kill, at most {} ms",
                    percentile(after_kill, 1), kLimitMs));
  write(options, nlohmann::json::array({figure("kill to robot stopped", after_kill, kLimitMs)}));
}

CLI::App* add_command(CLI::App& app, const char* name, const char* description,
                      const std::shared_ptr<ReactionOptions>& options) {
  options->rig.folder = std::filesystem::path{"bench-out"} / name;
  options->rig.daemon_config = std::filesystem::path{HOLDFAST_CONFIG_DIR} / "demo.toml";
  options->rig.guard_config = std::filesystem::path{HOLDFAST_CONFIG_DIR} / "demo-guard.toml";
  CLI::App* command = app.add_subcommand(name, description);
  command->add_option("--out", options->rig.folder, "folder for logs")->capture_default_str();
  command->add_option("--config", options->rig.daemon_config, "the daemon's configuration")
      ->capture_default_str();
  command->add_option("--domain", options->rig.domain, "DDS domain")
      ->check(CLI::Range(0, 230))
      ->capture_default_str();
  command->add_option("--camera", options->rig.camera_address, "address of the virtual camera")
      ->capture_default_str();
  command->add_option("--runs", options->runs, "injections, each while the robot is permitted")
      ->check(CLI::Range(1, 100'000))
      ->capture_default_str();
  command->add_option("--seed", options->rig.seed, "of scene and delays")->capture_default_str();
  command->add_option("--json", options->json_file, "write the figures to this file as JSON");
  command->footer(fmt::format("Example: holdfast-sim {} --runs 20 --json {}.json", name, name));
  return command;
}

}  // namespace

void add_reaction_commands(CLI::App& app) {
  const auto reactions = std::make_shared<ReactionOptions>();
  add_command(app, "reactions",
              "From a fault's evidence to the robot's stop, over many injections.", reactions)
      ->callback([reactions] { measure_reactions(*reactions); });
  const auto kills = std::make_shared<ReactionOptions>();
  kills->runs = 100;
  add_command(app, "kills", "From kill -9 of the daemon to the robot's stop.", kills)
      ->callback([kills] { measure_kills(*kills); });
}

}  // namespace holdfast::sim
