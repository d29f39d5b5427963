// SPDX-License-Identifier: Apache-2.0
// `holdfast-sim registration-error`: a registration against the virtual room's truth.
#include <algorithm>
#include <cmath>
#include <fstream>
#include <memory>
#include <string>

#include <CLI/CLI.hpp>
#include <Eigen/Cholesky>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "registration/registration_file.hpp"
#include "registration/rigid_fit.hpp"
#include "registration/stereo_calibration.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/commands.hpp"
#include "tests/sim/or/calibration_error.hpp"
#include "tests/sim/or/ideal_calibration.hpp"
#include "tests/sim/or/room.hpp"

namespace holdfast::sim {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;

struct Options {
  std::string registration, calibration, config, truth;
  int pose = 0;
  double deep_mm = 15;
  bool is_json = false;
};

Isometry3d true_head(const Options& options) {
  std::ifstream stream(options.truth);
  if (!stream) throw InputError(options.truth + ": cannot be read");
  Isometry3d T_ct_head = Isometry3d::Identity();
  try {
    const auto truth = nlohmann::json::parse(stream);
    const auto& rows = truth.at("poses").at(static_cast<std::size_t>(options.pose)).at("T_ct_head");
    for (int r = 0; r < 4; ++r)
      for (int c = 0; c < 4; ++c)
        T_ct_head.matrix()(r, c) =
            rows.at(static_cast<std::size_t>(r)).at(static_cast<std::size_t>(c)).get<double>();
  } catch (const nlohmann::json::exception& e) {
    throw InputError(fmt::format("{}: {}", options.truth, e.what()));
  }
  return T_ct_head;
}

/// Error of the targets of one depth, in one frame.
struct Error {
  double rms_mm = 0, max_mm = 0;
  double predicted_rms_mm = 0;
  double in_95_share = 0;  ///< of targets whose error lies in the predicted 95 % region
  double squared_sigmas =
      0;  ///< mean of error^T covariance^-1 error: 3 where the covariance is true
};

nlohmann::json as_json(const Error& e) {
  return {{"rms_mm", e.rms_mm},
          {"max_mm", e.max_mm},
          {"predicted_rms_mm", e.predicted_rms_mm},
          {"in_95_share", e.in_95_share},
          {"squared_sigmas", e.squared_sigmas}};
}

/// A grid of 30x20 mm across the line of sight, `below_mm` below the focal plane.
Error error_of(const registration::Registration& registration, const Isometry3d& T_camera_head,
               const Isometry3d& T_ct_head, double focus_mm, double below_mm) {
  constexpr double kChiSquared95 = 7.815;  // of three degrees of freedom
  constexpr int kReach = 2;
  Error error;
  double count = 0;
  for (int i = -kReach; i <= kReach; ++i)
    for (int j = -kReach; j <= kReach; ++j) {
      const Vector3d p_head(7.5 * i, 5.0 * j, focus_mm + below_mm);
      const Vector3d p_ct = T_ct_head * p_head;
      const Vector3d e = registration.T_camera_ct * p_ct - T_camera_head * p_head;
      const Eigen::Matrix3d covariance =
          registration::target_covariance(registration.T_camera_ct, registration.covariance, p_ct);
      const double squared = e.dot(covariance.ldlt().solve(e));
      error.rms_mm += e.squaredNorm();
      error.max_mm = std::max(error.max_mm, e.norm());
      error.predicted_rms_mm += covariance.trace();
      error.in_95_share += squared <= kChiSquared95 ? 1 : 0;
      error.squared_sigmas += squared;
      count += 1;
    }
  error.rms_mm = std::sqrt(error.rms_mm / count);
  error.predicted_rms_mm = std::sqrt(error.predicted_rms_mm / count);
  error.in_95_share /= count;
  error.squared_sigmas /= count;
  return error;
}

void print(const char* what, const Error& e) {
  fmt::print("{:<28} {:8.4f} {:8.4f}  {:9.4f}  {:9.2f}  {:6.2f}\n", what, e.rms_mm, e.max_mm,
             e.predicted_rms_mm, e.squared_sigmas, e.in_95_share);
}

void run(const Options& options) {
  const RoomConfig config = read_room_config(options.config);
  const registration::Registration registration =
      registration::load_registration(options.registration);
  const registration::StereoCalibration calibration =
      registration::read_stereo_calibration(options.calibration);
  const StereoOptics optics = Microscope(config.optics).at(config.zoom);
  const Isometry3d T_ct_head = true_head(options);
  const Isometry3d T_own_head =
      frame_of(registration::calibration_at_zoom(calibration, config.zoom), optics);
  const Isometry3d T_ideal_head = ideal_calibration(optics).T_camera_head;
  const auto error = [&](const Isometry3d& T_camera_head, double below_mm) {
    return error_of(registration, T_camera_head, T_ct_head, optics.focus_mm, below_mm);
  };
  const Error own = error(T_own_head, 0), own_deep = error(T_own_head, options.deep_mm);
  const Error ideal = error(T_ideal_head, 0), ideal_deep = error(T_ideal_head, options.deep_mm);
  if (options.is_json) {
    fmt::print(
        "{}\n",
        nlohmann::json{{"zoom", config.zoom},
                       {"own_frame", {{"site", as_json(own)}, {"deep", as_json(own_deep)}}},
                       {"truth_frame", {{"site", as_json(ideal)}, {"deep", as_json(ideal_deep)}}}}
            .dump());
    return;
  }
  fmt::print("{:<28} {:>8} {:>8}  {:>9}  {:>9}  {:>6}\n", "TRE, mm", "rms", "max", "predicted",
             "sigmas^2", "in 95%");
  print("calibration's frame, site", own);
  print("calibration's frame, deep", own_deep);
  print("truth file's frame, site", ideal);
  print("truth file's frame, deep", ideal_deep);
}

}  // namespace

void add_registration_error_command(CLI::App& app) {
  const auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand(
      "registration-error", "How wrong a registration is at targets of the site, in mm.");
  command->add_option("--registration", options->registration, "registration.json")->required();
  command->add_option("--calibration", options->calibration, "the stereo.yaml it was made with")
      ->required();
  command->add_option("--config", options->config, "the room of the images")->required();
  command->add_option("--truth", options->truth, "the room's truth file")->required();
  command->add_option("--pose", options->pose, "of the truth file")->check(CLI::Range(0, 100'000));
  command->add_option("--deep-mm", options->deep_mm, "second set of targets, this far below")
      ->check(CLI::Range(-100.0, 100.0))
      ->capture_default_str();
  command->add_flag("--json", options->is_json, "one JSON object on stdout");
  command->footer(
      "The calibration's frame: that in which it sees the working volume, with the zoom seated as "
      "on average; a robot\nthat is tied to the camera by images knows no other. The truth file's: "
      "that of the ideal calibration.\n"
      "Example: holdfast-sim registration-error --registration registration.json --calibration "
      "stereo.yaml \\\n  --config config/or.toml --truth truth.json");
  command->callback([options] { run(*options); });
}

}  // namespace holdfast::sim
