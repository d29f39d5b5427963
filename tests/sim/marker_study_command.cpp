// SPDX-License-Identifier: Apache-2.0
// `holdfast-sim marker-study`: how far off marker centres are over many microscopes and ears, and
// what it comes from: the images and their detection, the way the zoom is seated at this visit, the
// calibration. Images are rendered, calibrations made as by `calibration-study`.
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "registration/marker_triangulation.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/or/calibration_error.hpp"
#include "tests/sim/or/corner_views.hpp"
#include "tests/sim/or/ideal_calibration.hpp"
#include "tests/sim/or/point_error.hpp"
#include "tests/sim/or/room.hpp"
#include "tests/sim/study_commands.hpp"

namespace holdfast::sim {
namespace {

using nlohmann::json;
using registration::ZoomCalibration;

struct Options {
  std::string config;
  std::vector<std::uint32_t> seeds{1, 2, 3, 4, 5, 6, 7, 8};
  double noise_px = 0.03;
  registration::MarkerOptions markers;
  bool is_json = false;
};

// Squares of errors, summed over markers.
struct Sum {
  double absolute = 0, after_rigid = 0, predicted = 0;
  int count = 0;
  [[nodiscard]] json as_json() const {
    const auto rms = [this](double squares) { return std::sqrt(squares / std::max(count, 1)); };
    return {{"rms_mm", rms(absolute)},
            {"rms_after_rigid_mm", rms(after_rigid)},
            {"predicted_rms_mm", rms(predicted)},
            {"markers", count}};
  }
};

class Room {
 public:
  Room(RoomConfig config, std::uint32_t seed) : config_(std::move(config)) {
    config_.seed = config_.optics.seed = config_.phantom_seed = seed;
    config_.board.seed = config_.board_poses.seed = seed;
    config_.pattern = "none";
    phantom_ = make_phantom(config_);
    renderer_ = std::make_unique<Renderer>(phantom_.surfaces, phantom_.n_view_ct);
  }

  [[nodiscard]] const RoomConfig& config() const { return config_; }

  /// The pair of pose 0, the zoom seated as at `visit`.
  void expose(std::uint32_t visit) {
    const Microscope microscope(config_.optics);
    RoomShot shot;
    shot.optics = microscope.at(config_.zoom, visit);
    shot.lights = config_.lights;
    shot.sensor = config_.sensor;
    shot.T_ct_head = head_poses(config_, phantom_, microscope.focus_mm()).front();
    shot.seed = 2 * config_.seed + visit;
    left_ = renderer_->image(shot, Side::left);
    right_ = renderer_->image(shot, Side::right);
    T_head_ct_ = shot.T_ct_head.inverse();
  }

  /// The exposed pair measured with `calibration`, judged in its own frame.
  void measure(const ZoomCalibration& calibration, const registration::MarkerOptions& options,
               Sum& sum) const {
    const int dictionary = registration::marker_dictionary("4x4_50");
    const auto detected = [&](const cv::Mat& image, bool is_left) {
      return registration::detect_markers(
          image, dictionary,
          is_left ? calibration.camera_matrix_left : calibration.camera_matrix_right,
          is_left ? calibration.distortion_left : calibration.distortion_right);
    };
    const registration::MarkerSet set = registration::locate_markers(
        detected(left_, true), detected(right_, false), calibration, options);
    const Eigen::Isometry3d T_own_head =
        frame_of(calibration, Microscope(config_.optics).at(config_.zoom));
    std::vector<TruePoint> truth;
    for (const TrueMarker& marker : phantom_.markers)
      truth.push_back({std::to_string(marker.aruco_id),
                       T_own_head * T_head_ct_ * marker.T_ct_marker.translation()});
    const registration::Markups markups = registration::markups_of(set);
    for (const auto& point : error_by_label(markups.points, truth).points) {
      sum.absolute += point.error_mm.squaredNorm();
      sum.after_rigid += point.after_rigid_mm * point.after_rigid_mm;
      ++sum.count;
    }
    for (const auto& marker : set.markers) sum.predicted += marker.covariance_mm2.trace();
  }

 private:
  RoomConfig config_;
  Phantom phantom_;
  std::unique_ptr<Renderer> renderer_;
  Eigen::Isometry3d T_head_ct_ = Eigen::Isometry3d::Identity();
  cv::Mat left_, right_;
};

void run(const Options& options) {
  const RoomConfig config = read_room_config(options.config);
  const char* const names[] = {"images only: the optics known, the zoom seated as on average",
                               "and the zoom seated as at this visit",
                               "calibrated from boards, the zoom seated as on average",
                               "and the zoom seated as at this visit"};
  Sum sums[4];
  for (const std::uint32_t seed : options.seeds) {
    Room room(config, seed);
    const Microscope microscope(room.config().optics);
    const ZoomCalibration ideal = ideal_calibration(microscope.at(config.zoom)).model;
    const ZoomCalibration own = registration::calibration_at_zoom(
        calibrated_by_corners(room.config(), options.noise_px, {}).calibration, config.zoom);
    for (const bool is_seated : {false, true}) {
      room.expose(is_seated ? config.visit : 0);
      room.measure(ideal, options.markers, sums[is_seated ? 1 : 0]);
      room.measure(own, options.markers, sums[is_seated ? 3 : 2]);
    }
    if (!options.is_json) {
      fmt::print("seed {:>3} measured\n", seed);
      std::fflush(stdout);
    }
  }
  json rows = json::array();
  for (std::size_t i = 0; i < 4; ++i) {
    rows.push_back(sums[i].as_json());
    rows.back()["name"] = names[i];
    if (!options.is_json)
      fmt::print("{:<60} rms {:.4f} mm, after a rigid fit {:.4f} mm, predicted {:.4f} mm\n",
                 names[i], rows.back()["rms_mm"].get<double>(),
                 rows.back()["rms_after_rigid_mm"].get<double>(),
                 rows.back()["predicted_rms_mm"].get<double>());
  }
  if (options.is_json)
    fmt::print("{}\n",
               json{{"parts", rows}, {"zoom", config.zoom}, {"seeds", options.seeds}}.dump());
}

}  // namespace

void add_marker_study_command(CLI::App& program) {
  const auto options = std::make_shared<Options>();
  options->markers.marker_mm = 8;
  options->markers.marker_sigma_mm = 0.002;
  CLI::App& command = *program.add_subcommand(
      "marker-study", "How wrong triangulated markers are over many microscopes, and why.");
  command.add_option("--config", options->config, "the room; its seeds are replaced")->required();
  command.add_option("--seeds", options->seeds, "of microscope, ear, board and poses")
      ->delimiter(',');
  command.add_option("--noise-px", options->noise_px, "of the boards' corners, 1 sigma")
      ->check(CLI::Range(0.0, 5.0))
      ->capture_default_str();
  command
      .add_option("--marker-sigma-mm", options->markers.marker_sigma_mm,
                  "as `holdfast markers`: how exactly the squares are made; 0: not known at all")
      ->check(CLI::Range(0.0, 10.0))
      ->capture_default_str();
  command.add_flag("--json", options->is_json, "one JSON object on stdout");
  command.footer("Example: holdfast-sim marker-study --config config/or.toml --seeds 1,2,3,4");
  command.callback([options] { run(*options); });
}

}  // namespace holdfast::sim
