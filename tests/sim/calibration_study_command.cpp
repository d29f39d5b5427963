// SPDX-License-Identifier: Apache-2.0
// `holdfast-sim calibration-study`: what the calibration makes of corners that are known to a given
// noise, over many microscopes. Nothing is rendered: corners are projected through the true optics,
// so that dozens of microscopes take minutes, and a detector's faults do not come in.
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "registration/calibration_run.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/or/calibration_error.hpp"
#include "tests/sim/or/corner_views.hpp"
#include "tests/sim/or/room.hpp"
#include "tests/sim/study_commands.hpp"

namespace holdfast::sim {
namespace {

using nlohmann::json;

struct Options {
  std::string config;
  std::vector<std::uint32_t> seeds{1, 2, 3, 4, 5, 6, 7, 8};
  double noise_px = 0.03;
  registration::CalibrationOptions calibration;
  bool is_json = false;
};

json judged(const registration::CalibrationOutcome& outcome, const Microscope& microscope) {
  json at = json::array(), seated = json::array(), between = json::array(),
       predicted = json::array();
  const auto& zooms = outcome.calibration.zooms;
  for (std::size_t i = 0; i < zooms.size(); ++i) {
    const double zoom = zooms[i].zoom;
    at.push_back(calibration_error(zooms[i], microscope.at(zoom)).non_rigid_rms_mm);
    seated.push_back(
        calibration_error(zooms[i], microscope.at(zoom, board_visit(0, i))).non_rigid_rms_mm);
    predicted.push_back(outcome.zooms[i].predicted_nonrigid_mm);
    if (i + 1 == zooms.size()) break;
    const double middle = 0.5 * (zoom + zooms[i + 1].zoom);
    between.push_back(
        calibration_error(registration::calibration_at_zoom(outcome.calibration, middle),
                          microscope.at(middle))
            .non_rigid_rms_mm);
  }
  return {{"seated_mm", seated},
          {"at_mm", at},
          {"between_mm", between},
          {"predicted_mm", predicted},
          {"corner_sigma_px", outcome.corner_sigma_px},
          {"inflation", outcome.covariance_inflation}};
}

double worst(const json& values) {
  double most = 0;
  for (const json& value : values) most = std::max(most, value.get<double>());
  return most;
}

void run(const Options& options) {
  RoomConfig config = read_room_config(options.config);
  json rows = json::array();
  double worst_seated = 0, worst_at = 0, worst_between = 0;
  for (const std::uint32_t seed : options.seeds) {
    config.seed = config.optics.seed = seed;
    config.board.seed = config.board_poses.seed = seed;
    const Microscope microscope(config.optics);
    json row =
        judged(calibrated_by_corners(config, options.noise_px, options.calibration), microscope);
    row["seed"] = seed;
    worst_seated = std::max(worst_seated, worst(row["seated_mm"]));
    worst_at = std::max(worst_at, worst(row["at_mm"]));
    worst_between = std::max(worst_between, worst(row["between_mm"]));
    if (!options.is_json) {
      const auto list = [](const json& values) {
        std::string text;
        for (const json& value : values) text += fmt::format(" {:.4f}", value.get<double>());
        return text;
      };
      fmt::print(
          "seed {:>3}  as seated{}  on average{}  between{}  predicted{}  corners {:.3f} px  "
          "inflation {:.2f}\n",
          seed, list(row["seated_mm"]), list(row["at_mm"]), list(row["between_mm"]),
          list(row["predicted_mm"]), row["corner_sigma_px"].get<double>(),
          row["inflation"].get<double>());
      std::fflush(stdout);
    }
    rows.push_back(std::move(row));
  }
  if (options.is_json)
    fmt::print("{}\n", json{{"seeds", rows},
                            {"noise_px", options.noise_px},
                            {"worst_seated_mm", worst_seated},
                            {"worst_at_zooms_mm", worst_at},
                            {"worst_between_zooms_mm", worst_between}}
                           .dump());
  else
    fmt::print("worst: {:.4f} mm at the zooms as seated, {:.4f} on average, {:.4f} between them\n",
               worst_seated, worst_at, worst_between);
}

}  // namespace

void add_calibration_study_command(CLI::App& program) {
  const auto options = std::make_shared<Options>();
  CLI::App& command = *program.add_subcommand(
      "calibration-study", "How wrong calibrations of many virtual microscopes are, in mm.");
  command.add_option("--config", options->config, "the room; its seeds are replaced")->required();
  command.add_option("--seeds", options->seeds, "of microscope, board and poses")->delimiter(',');
  command.add_option("--noise-px", options->noise_px, "of each corner's x and y, 1 sigma")
      ->check(CLI::Range(0.0, 5.0))
      ->capture_default_str();
  command
      .add_option("--coefficients", options->calibration.bundle.coefficients, "of the distortion")
      ->check(CLI::IsMember({5, 12}))
      ->capture_default_str();
  command
      .add_option("--distortion-prior-px", options->calibration.bundle.distortion_prior_px,
                  "how far a coefficient may move the image's corner, 1 sigma")
      ->check(CLI::Range(1e-3, 1e3))
      ->capture_default_str();
  command
      .add_option("--prism-prior-px", options->calibration.bundle.prism_prior_px,
                  "likewise a coefficient of the thin prism")
      ->check(CLI::Range(1e-4, 1e3))
      ->capture_default_str();
  command.add_flag("--json", options->is_json, "one JSON object on stdout");
  command.footer("Example: holdfast-sim calibration-study --config config/or.toml --seeds 1,2,3,4");
  command.callback([options] { run(*options); });
}

}  // namespace holdfast::sim
