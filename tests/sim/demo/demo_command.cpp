// SPDX-License-Identifier: Apache-2.0
// `holdfast-sim demo`: the whole chain on the virtual operating room, and what came of it.
#include <cstdio>
#include <filesystem>
#include <functional>
#include <memory>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "bridge/atomic_file.hpp"
#include "bridge/command_line.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/commands.hpp"
#include "tests/sim/demo/evaluation.hpp"
#include "tests/sim/demo/report.hpp"
#include "tests/sim/demo/rig.hpp"
#include "tests/sim/trajectory.hpp"

namespace holdfast::sim {
namespace {

using namespace std::chrono_literals;

struct DemoOptions {
  RigParameters rig;
  std::string json_file;
  bool is_quick = false;
  bool has_json = false;
};

constexpr auto kStartPatience = 60s;
constexpr auto kStopPatience = 3s;
constexpr auto kRecoveryPatience = 60s;
constexpr auto kFaultDuration = 800ms;

void progress(const std::string& line) {
  fmt::print(stderr, "{}\n", line);
}

void move(Rig& rig, const std::string& motion) {
  const Trajectory trajectory{motion, 1.0, false, 200.0};  // for its duration only
  progress(fmt::format("  moving: {} ({:.0f} s)", motion,
                       static_cast<double>(trajectory.duration() / 1ms) / 1000));
  (void)rig.inject("motion " + motion);
  rig.run_for(trajectory.duration());
  if (!rig.wait_permitted(kRecoveryPatience))
    throw RefusedError(
        fmt::format("no permission within {} s after '{}'", kRecoveryPatience / 1s, motion));
}

/// One fault while the site moves; the window in which a stop is expected of it.
struct Injection {
  const char* name;
  std::function<std::chrono::nanoseconds(Rig&)> begin, end;
};

ExpectedStop inject_fault(Rig& rig, const Injection& fault) {
  progress(fmt::format("  injecting: {}", fault.name));
  (void)rig.inject("motion linear:0.1");
  rig.run_for(1s);
  const auto require_permission = [&](const char* when) {
    if (!rig.wait_permitted(kRecoveryPatience))
      throw RefusedError(fmt::format("no permission within {} s {} '{}'", kRecoveryPatience / 1s,
                                     when, fault.name));
  };
  require_permission("before");
  ExpectedStop window{fault.name, fault.begin(rig), {}};
  const bool has_stopped = rig.wait_withdrawn(kStopPatience);
  rig.run_for(kFaultDuration);
  window.to = fault.end(rig);
  if (!has_stopped)
    throw RefusedError(fmt::format("'{}' did not withdraw permission within {} s", fault.name,
                                   kStopPatience / 1s));
  require_permission("after");
  return window;
}

/// What a camera can do wrong, and a zoom turned away and back.
std::vector<Injection> injections(const rt::DaemonConfig& config) {
  const auto camera = [](const char* name) {
    const std::string fault = name;
    return Injection{name, [fault](Rig& rig) { return rig.inject(fault + " on"); },
                     [fault](Rig& rig) { return rig.inject(fault + " off"); }};
  };
  std::vector<Injection> all = {camera("freeze"), camera("occlude")};
  if (config.optics.local.empty()) return all;
  const double zoom = config.registration.zoom;
  const auto turn = [](double to) {
    return [to](Rig& rig) { return rig.turn(fmt::format("zoom {}", to)); };
  };
  all.push_back({"zoom", turn(zoom + 0.2), turn(zoom)});
  return all;
}

void run_demo(const DemoOptions& options) {
  bridge::catch_interrupts();
  progress(fmt::format(
      "virtual operating room: camera, microscope (over a local bus: this is no CAN), daemon, "
      "guard, robot, operator; logs in {}",
      options.rig.folder.string()));
  Rig rig{options.rig};
  if (!rig.wait_permitted(kStartPatience))
    throw RefusedError(fmt::format("no permission within {} s of the start; see {}/daemon.log",
                                   kStartPatience / 1s, options.rig.folder.string()));
  for (const char* motion :
       options.is_quick ? std::array{"still:1,linear:0.1", "still:1,spiral:0.2", "still:1,bump:1.5"}
                        : std::array{"still:1,linear", "still:1,spiral", "still:1,bump:1.5"})
    move(rig, motion);
  std::vector<ExpectedStop> expected;
  for (const Injection& fault : injections(rig.config()))
    expected.push_back(inject_fault(rig, fault));
  rig.run_for(500ms);
  rig.finish();

  const Evaluation evaluation =
      evaluate(rig.config(), rig.truth_file(), rig.events_file(), rig.robot_file(), expected,
               rig.tracker_us(), HazardLimits{});
  write_report(evaluation, options.rig.folder);
  const nlohmann::json result = to_json(evaluation);
  if (!options.json_file.empty())
    bridge::write_file_atomically(options.json_file, result.dump(1) + "\n");
  if (options.has_json)
    fmt::print("{}\n", result.dump());
  else
    fmt::print("{}", to_text(evaluation, options.rig.folder));
  if (evaluation.hazards > 0)
    throw RefusedError(fmt::format("{} times permitted while the true error was over its limit",
                                   evaluation.hazards));
}

std::filesystem::path default_config() {
  return std::filesystem::path{HOLDFAST_CONFIG_DIR} / "demo.toml";
}

}  // namespace

void add_demo_command(CLI::App& app) {
  auto options = std::make_shared<DemoOptions>();
  options->rig.folder = "demo-out";
  options->rig.daemon_config = default_config();
  options->rig.guard_config = options->rig.daemon_config.parent_path() / "demo-guard.toml";
  CLI::App* command = app.add_subcommand(
      "demo", "The whole chain on the virtual operating room: camera, daemon, robot, operator.");
  command->add_option("--out", options->rig.folder, "folder for logs, report and plots")
      ->capture_default_str();
  command->add_option("--config", options->rig.daemon_config, "the daemon's configuration")
      ->capture_default_str();
  command->add_option("--domain", options->rig.domain, "DDS domain")
      ->check(CLI::Range(0, 230))
      ->capture_default_str();
  command->add_option("--camera", options->rig.camera_address, "address of the virtual camera")
      ->capture_default_str();
  command->add_option("--seed", options->rig.seed, "same seed, same scene")->capture_default_str();
  command->add_flag("--secured", options->rig.is_secured,
                    "with DDS Security: keys for everybody, made for this run");
  command->add_flag("--quick", options->is_quick, "short trajectories");
  command->add_option("--json", options->json_file, "write the result to this file as JSON");
  command->footer(
      "Example: holdfast demo --out demo-out --json demo-out/result.json\n"
      "What comes before it, from calibration to registration: holdfast demo --setup --help");
  command->callback([options] { run_demo(*options); });
}

}  // namespace holdfast::sim
