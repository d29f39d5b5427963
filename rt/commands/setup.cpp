// SPDX-License-Identifier: Apache-2.0
// `holdfast demo --setup`: the set-up before an operation, on the virtual rig.
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <opencv2/core.hpp>
#include <opencv2/core/utils/logger.hpp>
#include <unistd.h>

#include "bridge/command_line.hpp"
#include "rt/commands/rig_commands.hpp"
#include "rt/core/error.hpp"
#include "rt/study/pattern_choice.hpp"
#include "rt/study/rig.hpp"
#include "rt/study/setup_flow.hpp"

namespace holdfast::rt {
namespace {

constexpr const char* kExample =
    "Example: calibrate, scan, project, reconstruct and register, no number typed\n"
    "  holdfast demo --setup --out setup/\n"
    "setup/registration.json, with keyframe, depth and camera.yaml, is what holdfastd loads. Exit\n"
    "code 1: a stage refused; its reason is on stderr and there is no registration.json.";

struct Options {
  SetupSettings settings;
  std::string out, rig, patterns;
  std::uint32_t seed = 1, phantom_seed = 1000;
  bool is_json = false;
};

void report(const Options& options, const SetupOutcome& outcome) {
  if (!options.is_json) {
    for (const SetupStage& stage : outcome.stages)
      fmt::print("{:<15} {:>7.1f} s  {}\n", stage.name, stage.seconds, stage.measured);
    if (!outcome.refusal.empty())
      fmt::print("{:<15} {:>9}  {}\n", "refused", "", outcome.refusal);
    else
      fmt::print("{}/registration.json: registered\n", options.out);
    return;
  }
  nlohmann::ordered_json json;
  json["out"] = options.out;
  json["stages"] = nlohmann::json::array();
  for (const SetupStage& stage : outcome.stages)
    json["stages"].push_back(
        {{"name", stage.name}, {"seconds", stage.seconds}, {"measured", stage.measured}});
  json["refusal"] = outcome.refusal.empty() ? nlohmann::json() : nlohmann::json(outcome.refusal);
  if (outcome.refusal.empty()) {
    json["fre_mm"] = outcome.fre_mm;
    for (const auto& [target, rms] : outcome.predicted_tre_mm)
      json["predicted_tre_mm"][target] = rms;
  }
  fmt::print("{}\n", json.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace));
}

void prepare(Options& options) {
  SetupSettings& s = options.settings;
  s.rig = options.rig.empty()
              ? virtual_rig({"--seed", fmt::format("{}", options.seed), "--phantom-seed",
                             fmt::format("{}", options.phantom_seed)})
              : rig_command(options.rig);
  if (!options.patterns.empty())
    s.pattern = pattern_for(s.zoom, read_best_patterns(options.patterns));
}

void run(Options options) {
  cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  cv::setNumThreads(options.settings.parameters.threads);
  bridge::catch_interrupts();
  prepare(options);
  const SetupOutcome outcome =
      run_setup(options.settings, options.out, [](const std::string& what) {
        if (bridge::is_interrupted()) throw InterruptedError("interrupted");
        // A refusal is one line on stderr: progress only where a person looks on.
        if (isatty(STDERR_FILENO) == 1) fmt::print(stderr, "\r\033[K{}", what);
      });
  if (isatty(STDERR_FILENO) == 1) fmt::print(stderr, "\r\033[K");
  report(options, outcome);
  if (!outcome.refusal.empty()) throw RefusedError(outcome.refusal);
}

}  // namespace

void run_demo_setup(std::vector<std::string> words) {
  Options options;
  SetupSettings& s = options.settings;
  CLI::App app("The set-up before an operation, on the virtual rig.", "holdfast demo --setup");
  app.add_option("--out", options.out, "Folder for everything that is made")->required();
  app.add_option("--zoom", s.zoom, "Of the microscope")
      ->check(CLI::Range(1.1, 1.5))
      ->capture_default_str();
  app.add_option("--seed", options.seed, "Of the virtual rig")->capture_default_str();
  app.add_option("--phantom-seed", options.phantom_seed, "The ear's shape; from 1000 on: held out")
      ->capture_default_str();
  app.add_option("--pairs", s.calibration_pairs, "Calibration pairs")
      ->check(CLI::Range(6, 200))
      ->capture_default_str();
  app.add_option("--rig", options.rig,
                 "Command of the rig (default: holdfast-sim rig beside this)");
  app.add_option("--patterns", options.patterns,
                 "patterns.toml of optimize-pattern (default: the default dots)");
  app.add_option("--threads", s.parameters.threads, "Of the computation")
      ->check(CLI::Range(1, 64))
      ->capture_default_str();
  app.add_flag("--json", options.is_json, "Print one JSON object on stdout");
  app.footer(kExample);
  std::reverse(words.begin(), words.end());  // as CLI11 wants them
  try {
    app.parse(words);
  } catch (const CLI::CallForHelp&) {
    fmt::print("{}", app.help());
    return;
  }
  run(options);
}

}  // namespace holdfast::rt
