// SPDX-License-Identifier: Apache-2.0
// `holdfast-sim calibration-error`, `marker-error` and `bead-error`: the pipeline's results against
// the virtual room's truth.
#include <cmath>
#include <memory>
#include <string>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "registration/markups.hpp"
#include "registration/stereo_calibration.hpp"
#include "tests/sim/commands.hpp"
#include "tests/sim/or/calibration_error.hpp"
#include "tests/sim/or/ideal_calibration.hpp"
#include "tests/sim/or/point_error.hpp"
#include "tests/sim/or/room.hpp"
#include "tests/sim/study_commands.hpp"

namespace holdfast::sim {
namespace {

using nlohmann::json;

struct CalibrationOptions {
  std::string calibration, config;
  std::uint32_t visit = 0;
  bool is_json = false;
};

json entry(const CalibrationError& e, bool is_between) {
  return {{"zoom", e.zoom},
          {"between", is_between},
          {"non_rigid_rms_mm", e.non_rigid_rms_mm},
          {"non_rigid_max_mm", e.non_rigid_max_mm},
          {"scale", e.scale},
          {"epipolar_rms_px", e.epipolar_rms_px},
          {"points", e.points}};
}

void print(const json& rows) {
  fmt::print("{:>6}  {:>22}  {:>8}  {:>8}  {:>10}\n", "zoom", "non-rigid rms, max mm", "scale",
             "epipolar", "points");
  for (const json& row : rows)
    fmt::print("{:>6.3f}  {:>10.4f} {:>11.4f}  {:>8.5f}  {:>5.3f} px  {:>7}{}\n",
               row["zoom"].get<double>(), row["non_rigid_rms_mm"].get<double>(),
               row["non_rigid_max_mm"].get<double>(), row["scale"].get<double>(),
               row["epipolar_rms_px"].get<double>(), row["points"].get<int>(),
               row["between"].get<bool>() ? "  between" : "");
}

void run_calibration_error(const CalibrationOptions& options) {
  const RoomConfig config = read_room_config(options.config);
  const registration::StereoCalibration calibration =
      registration::read_stereo_calibration(options.calibration);
  const Microscope microscope(config.optics);
  json rows = json::array();
  double worst_at = 0, worst_between = 0;
  for (std::size_t i = 0; i < calibration.zooms.size(); ++i) {
    const double zoom = calibration.zooms[i].zoom;
    const CalibrationError at =
        calibration_error(calibration.zooms[i], microscope.at(zoom, options.visit));
    rows.push_back(entry(at, false));
    worst_at = std::max(worst_at, at.non_rigid_rms_mm);
    if (i + 1 == calibration.zooms.size()) break;
    const double middle = 0.5 * (zoom + calibration.zooms[i + 1].zoom);
    const CalibrationError between =
        calibration_error(registration::calibration_at_zoom(calibration, middle),
                          microscope.at(middle, options.visit));
    rows.push_back(entry(between, true));
    worst_between = std::max(worst_between, between.non_rigid_rms_mm);
  }
  if (options.is_json) {
    fmt::print("{}\n", json{{"zooms", rows},
                            {"worst_at_zooms_mm", worst_at},
                            {"worst_between_zooms_mm", worst_between}}
                           .dump());
    return;
  }
  print(rows);
  fmt::print("worst: {:.4f} mm at the zooms, {:.4f} mm between them\n", worst_at, worst_between);
}

struct PointOptions {
  std::string points, truth, point = "marker", calibration, config;
  int pose = 0;
  double reach_mm = 3;
  bool is_json = false;
};

json number(double value) {
  return std::isfinite(value) ? json(value) : json(nullptr);
}

void report(const PointError& error, bool is_json) {
  if (is_json) {
    json points = json::array();
    for (const auto& p : error.points)
      points.push_back({{"label", p.label},
                        {"error_mm", {p.error_mm.x(), p.error_mm.y(), p.error_mm.z()}},
                        {"after_rigid_mm", number(p.after_rigid_mm)}});
    fmt::print("{}\n", json{{"points", points},
                            {"rms_mm", number(error.rms_mm)},
                            {"max_mm", error.max_mm},
                            {"rms_after_rigid_mm", number(error.rms_after_rigid_mm)},
                            {"missing", error.missing},
                            {"surplus", error.surplus}}
                           .dump());
    return;
  }
  for (const auto& p : error.points)
    fmt::print("{:>4}  x {:+.4f}  y {:+.4f}  z {:+.4f}  |e| {:.4f}  after rigid {:.4f} mm\n",
               p.label, p.error_mm.x(), p.error_mm.y(), p.error_mm.z(), p.error_mm.norm(),
               p.after_rigid_mm);
  fmt::print(
      "rms {:.4f} mm, max {:.4f} mm; after a rigid fit rms {:.4f} mm; {} missing, {} surplus\n",
      error.rms_mm, error.max_mm, error.rms_after_rigid_mm, error.missing, error.surplus);
}

void run_marker_error(const PointOptions& options) {
  std::vector<TruePoint> truth =
      true_points(options.truth, options.point + "_camera", options.pose);
  if (!options.calibration.empty()) {
    const RoomConfig config = read_room_config(options.config);
    const StereoOptics optics = Microscope(config.optics).at(config.zoom);
    const Eigen::Isometry3d T_own_ideal =
        frame_of(registration::calibration_at_zoom(
                     registration::read_stereo_calibration(options.calibration), config.zoom),
                 optics) *
        ideal_calibration(optics).T_camera_head.inverse();
    for (TruePoint& point : truth) point.p_mm = T_own_ideal * point.p_mm;
  }
  report(error_by_label(registration::read_markups(options.points), truth), options.is_json);
}

void run_bead_error(const PointOptions& options) {
  report(error_by_place(registration::read_markups(options.points), true_beads(options.truth),
                        options.reach_mm),
         options.is_json);
}

}  // namespace

void add_or_error_commands(CLI::App& app) {
  add_calibration_study_command(app);
  add_marker_study_command(app);
  const auto calibration = std::make_shared<CalibrationOptions>();
  CLI::App* command = app.add_subcommand(
      "calibration-error", "How wrong a calibration of the virtual microscope is, in mm.");
  command->add_option("--calibration", calibration->calibration, "stereo.yaml")->required();
  command->add_option("--config", calibration->config, "the room")->required();
  command->add_option("--visit", calibration->visit, "how the zoom is seated; 0: its mean")
      ->capture_default_str();
  command->add_flag("--json", calibration->is_json, "one JSON object on stdout");
  command->footer(
      "Example: holdfast-sim calibration-error --calibration stereo.yaml --config config/or.toml");
  command->callback([calibration] { run_calibration_error(*calibration); });

  const auto add = [&app](const char* name, const char* what, const std::string& file_option) {
    auto options = std::make_shared<PointOptions>();
    CLI::App* sub = app.add_subcommand(name, what);
    sub->add_option(file_option, options->points, "what was measured (.mrk.json)")->required();
    sub->add_option("--truth", options->truth, "what the simulator wrote there")->required();
    sub->add_flag("--json", options->is_json, "one JSON object on stdout");
    sub->footer(fmt::format("Example: holdfast-sim {} {} m.mrk.json --truth truth.json", name,
                            file_option));
    return std::pair{sub, options};
  };
  const auto [markers, marker_options] =
      add("marker-error", "Triangulated markers against where they truly are.", "--markers");
  markers->add_option("--pose", marker_options->pose, "of the truth file")
      ->check(CLI::Range(0, 100'000));
  markers->add_option("--point", marker_options->point, "which point was measured")
      ->check(CLI::IsMember({"marker", "bead"}))
      ->capture_default_str();
  CLI::Option* own =
      markers->add_option("--calibration", marker_options->calibration,
                          "judge in the frame of this stereo.yaml, not in the truth file's");
  own->needs(markers->add_option("--config", marker_options->config, "the room of the images"));
  markers->callback([options = marker_options] { run_marker_error(*options); });
  const auto [beads, bead_options] = add(
      "bead-error", "Bead centres found in the CT against where they truly are.", "--fiducials");
  beads->add_option("--reach-mm", bead_options->reach_mm, "how far a bead may be off to be paired")
      ->check(CLI::Range(0.01, 100.0))
      ->capture_default_str();
  beads->callback([options = bead_options] { run_bead_error(*options); });
}

}  // namespace holdfast::sim
