// SPDX-License-Identifier: Apache-2.0
// `holdfast doctor`: is this machine fit, and if not, what to do.
#include "rt/doctor.hpp"

#include <algorithm>
#include <memory>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "bridge/camera_source.hpp"
#include "rt/commands/commands.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

const char* name_of(DoctorState state) {
  switch (state) {
    case DoctorState::ok:
      return "ok";
    case DoctorState::warning:
      return "warning";
    case DoctorState::failed:
      return "failed";
  }
  return "unknown";
}

void run(bool has_json, bool has_cameras) {
  DoctorParameters parameters;
  if (has_cameras) parameters.cameras_found = static_cast<int>(bridge::count_cameras());
  const std::vector<DoctorFinding> findings = run_doctor(parameters);
  nlohmann::json json = nlohmann::json::array();
  for (const DoctorFinding& f : findings) {
    if (has_json)
      json.push_back({{"check", f.check},
                      {"state", name_of(f.state)},
                      {"measured", f.measured},
                      {"advice", f.advice}});
    else
      fmt::print("{:<8} {:<20} {}{}{}\n", name_of(f.state), f.check, f.measured,
                 f.advice.empty() ? "" : "\n" + std::string(30, ' ') + "-> ", f.advice);
  }
  if (has_json) fmt::print("{}\n", nlohmann::json{{"findings", json}}.dump());
  const auto failed = std::count_if(findings.begin(), findings.end(),
                                    [](const auto& f) { return f.state == DoctorState::failed; });
  if (failed > 0)
    throw RefusedError(fmt::format("{} of {} checks failed", failed, findings.size()));
}

}  // namespace

void add_doctor(CLI::App& app) {
  struct Options {
    bool has_json = false, no_cameras = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand(
      "doctor", "Checks kernel, scheduling, memory lock, network, CAN, cameras; says what to do.");
  command->add_flag("--json", options->has_json, "one JSON object");
  command->add_flag("--no-cameras", options->no_cameras, "do not look for cameras");
  command->footer("Exit code 1 when a check failed.\nExample: holdfast doctor --json");
  command->callback([options] { run(options->has_json, !options->no_cameras); });
}

}  // namespace holdfast::rt
