// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/room_server.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <string>
#include <utility>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "bridge/atomic_file.hpp"
#include "bridge/depth_file.hpp"
#include "registration/stereo_calibration.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/or/beam_error.hpp"
#include "tests/sim/or/calibration_error.hpp"
#include "tests/sim/or/ct_scanner.hpp"
#include "tests/sim/or/depth_error.hpp"
#include "tests/sim/or/dicom_series.hpp"
#include "tests/sim/or/ideal_calibration.hpp"
#include "tests/sim/or/tracking_error.hpp"
#include "tests/sim/trajectory.hpp"

namespace holdfast::sim {
namespace {

using nlohmann::json;

// The pattern's light is 740 nm and the OR lamps hardly shine there (paper A: under 10 uW), so
// little of theirs is left in a frame taken through the filter.
constexpr double kFilteredOrLight = 0.05;
constexpr double kOrLight = 0.8, kMicroscopeLight = 0.9;
constexpr double kMarkerOrLight = 0.6;  // of the frames without the pattern and its filter
constexpr double kLaserSpeckle = 0.3;   // a diffractive pattern is a laser's; an LED's has none
constexpr int kPoseMax = 999, kPairsMax = 500, kFramesMax = 20'000;

template <typename Value>
Value member(const json& request, const char* name) {
  try {
    return request.at(name).get<Value>();
  } catch (const json::exception&) {
    throw InputError(
        fmt::format("request {}: '{}' is missing or of a wrong type", request.dump(), name));
  }
}
template <typename Value>
Value member(const json& request, const char* name, Value fallback) {
  return request.contains(name) ? member<Value>(request, name) : std::move(fallback);
}

int whole(const json& request, const char* name, int least, int most) {
  const int value = member<int>(request, name, least);
  if (value < least || value > most)
    throw InputError(
        fmt::format("request {}: '{}' must be {} to {}", request.dump(), name, least, most));
  return value;
}

double zoom_of(const json& request) {
  const auto zoom = member<double>(request, "zoom");
  if (!(zoom >= Microscope::kZoomMin && zoom <= Microscope::kZoomMax))
    throw InputError(fmt::format("request {}: 'zoom' must be {} to {}", request.dump(),
                                 Microscope::kZoomMin, Microscope::kZoomMax));
  return zoom;
}

void set_lamps(const json& request, RoomConfig& config, StereoWish& wish) {
  const auto lamps = member<std::string>(request, "lamps", "");
  if (lamps.empty()) return;
  const bool is_or = lamps == "or", is_microscope = lamps == "microscope";
  if (!is_or && !is_microscope && lamps != "filtered")
    throw InputError(
        fmt::format("request {}: 'lamps' must be filtered, or, or microscope", request.dump()));
  config.lights.or_light = is_or ? kOrLight : is_microscope ? 0 : kFilteredOrLight;
  config.lights.microscope_light = is_microscope ? kMicroscopeLight : 0;
  wish.off_or_light = kMarkerOrLight;
}

void set_pattern(const json& request, RoomConfig& config) {
  const auto pattern = member<std::string>(request, "pattern", "");
  config.pattern = pattern.empty() ? "none" : pattern == "random" ? "diffractive" : "file";
  if (config.pattern == "file") config.pattern_file = std::filesystem::absolute(pattern);
  if (config.pattern == "diffractive")
    config.lights.speckle = std::max(config.lights.speckle, kLaserSpeckle);
}

json number(double value) {
  return std::isfinite(value) ? json(value) : json(nullptr);
}

json as_json(const DepthError& e) {
  return {{"seen", e.seen},
          {"known", e.known},
          {"coverage", number(e.coverage)},
          {"median_mm", number(e.median_mm)},
          {"mean_mm", number(e.mean_mm)},
          {"rms_mm", number(e.rms_mm)},
          {"p95_mm", number(e.p95_mm)},
          {"p99_mm", number(e.p99_mm)},
          {"share_over_1_mm", number(e.share_over_1_mm)},
          {"share_over_1_mm_off_edges", number(e.share_over_1_mm_off_edges)}};
}

json error_of(const json& request, const RoomConfig& config, const RoomScene& scene) {
  const auto calibration =
      registration::read_stereo_calibration(member<std::string>(request, "calibration"));
  const cv::Mat_<float> depth_mm = bridge::read_depth_file(member<std::string>(request, "depth"),
                                                           kSensorWidthPx, kSensorHeightPx);
  return as_json(depth_error(depth_mm, registration::calibration_at_zoom(calibration, config.zoom),
                             config, scene, config.poses - 1));
}

void set_motion(const json& request, RoomConfig& config) {
  constexpr double kRateMax = 240;
  config.motion = member<std::string>(request, "motion");
  config.frame_rate_hz = member<double>(request, "rate_hz");
  if (!(config.frame_rate_hz >= 1 && config.frame_rate_hz <= kRateMax))
    throw InputError(
        fmt::format("request {}: 'rate_hz' must be 1 to {}", request.dump(), kRateMax));
  config.disturbances = member<std::string>(request, "disturbances", "");
  config.frames_max = member<int>(request, "frames_max", kFramesMax);
  config.text += request.dump();  // what the frames depend on
}

json sequence_of(const RoomConfig& config, RoomScene& scene, const std::string& out,
                 const Progress& progress) {
  const RoomFiles files = write_sequence(config, scene, out, progress);
  const cv::Rect& r = files.region_px;
  return {{"frames", files.frames}, {"region_px", {r.x, r.y, r.width, r.height}}};
}

/// What judges a sequence's tracking: how the site moved, told in the calibration's camera frame.
struct SequenceTruth {
  Trajectory motion;
  Eigen::Isometry3d T_camera_ideal;
  double depth_mm;
};

SequenceTruth truth_of(const json& request, const RoomConfig& config) {
  const Microscope microscope(config.optics);
  const auto calibration =
      registration::read_stereo_calibration(member<std::string>(request, "calibration"));
  const Eigen::Isometry3d T_camera_ideal =
      frame_of(registration::calibration_at_zoom(calibration, config.zoom),
               microscope.at(config.zoom, config.visit)) *
      ideal_calibration(microscope.at(config.zoom)).T_camera_head.inverse(Eigen::Isometry);
  return {Trajectory(config.motion, config.motion_scale, false, microscope.focus_mm()),
          T_camera_ideal, microscope.focus_mm()};
}

json tracking_error_of(const json& request, const RoomConfig& config) {
  const SequenceTruth truth = truth_of(request, config);
  std::optional<Eigen::Vector3d> p_site_mm;
  if (request.contains("point_site_mm")) {
    const auto p = member<std::array<double, 3>>(request, "point_site_mm");
    p_site_mm = Eigen::Vector3d(p[0], p[1], p[2]);
  }
  const TrackingError e = tracking_error(member<std::string>(request, "poses"), truth.motion,
                                         truth.T_camera_ideal, truth.depth_mm, p_site_mm);
  bridge::write_file_atomically(member<std::string>(request, "rows"), e.rows);
  return {{"frames", e.frames},
          {"lost", e.lost},
          {"silently_wrong", e.silently_wrong},
          {"step_mean_um", number(e.step_mean_um)},
          {"step_sd_um", number(e.step_sd_um)},
          {"absolute_rms_um", number(e.absolute_rms_um)},
          {"absolute_max_um", number(e.absolute_max_um)},
          {"depth_rms_um", number(e.depth_rms_um)},
          {"rotation_rms_mrad", number(e.rotation_rms_mrad)}};
}

json beam_error_of(const json& request, const RoomConfig& config) {
  const SequenceTruth truth = truth_of(request, config);
  const BeamError e = beam_error(member<std::string>(request, "commands"), truth.motion,
                                 truth.T_camera_ideal, truth.depth_mm, {});
  bridge::write_file_atomically(member<std::string>(request, "rows"), e.rows);
  return {{"on_s", e.on_s},
          {"on_share", e.on_share},
          {"rms_um", number(e.rms_um)},
          {"p99_um", number(e.p99_um)},
          {"max_um", number(e.max_um)},
          {"uncompensated_rms_um", number(e.uncompensated_rms_um)}};
}

}  // namespace

RoomServer::RoomServer(RoomConfig config) : config_(std::move(config)) {}

RoomScene& RoomServer::scene() {
  if (!scene_) scene_ = std::make_unique<RoomScene>(config_);
  return *scene_;
}

json RoomServer::answer(const json& request, const Progress& progress) {
  const auto what = member<std::string>(request, "do");
  RoomConfig config = config_;
  if (what == "ct") {
    const CtVolume volume = scan(scene().phantom, {});
    const auto out = member<std::string>(request, "out");
    return {{"files", write_dicom_series(volume, {}, out).files.size()}};
  }
  if (what == "boards") {
    config.calibration_zooms = {zoom_of(request)};
    config.board_poses.count = whole(request, "pairs", 1, kPairsMax);
    const auto out = member<std::string>(request, "out");
    return {{"files", write_calibration_images(config, out, progress).files}};
  }
  if (what == "robot")
    return {{"lag_ms", std::chrono::duration<double, std::milli>(BeamRobot{}.lag()).count()}};
  const bool is_sequence = what == "sequence", is_tracking_error = what == "tracking-error",
             is_beam_error = what == "beam-error";
  if (what != "pair" && what != "depth-error" && !is_sequence && !is_tracking_error &&
      !is_beam_error)
    throw InputError(
        fmt::format("request {}: 'do' must be boards, ct, pair, depth-error, sequence, "
                    "tracking-error, robot or beam-error",
                    request.dump()));
  config.zoom = zoom_of(request);
  if (is_sequence || is_tracking_error || is_beam_error) set_motion(request, config);
  if (is_tracking_error) return tracking_error_of(request, config);
  if (is_beam_error) return beam_error_of(request, config);
  StereoWish wish{whole(request, "pose", 0, kPoseMax), {}, false};
  config.poses = *wish.only_pose + 1;  // a pose does not depend on how many come after it
  if (what == "depth-error") return error_of(request, config, scene());
  set_lamps(request, config, wish);
  set_pattern(request, config);
  wish.has_off = member<bool>(request, "off", false);
  const auto out = member<std::string>(request, "out");
  if (is_sequence) return sequence_of(config, scene(), out, progress);
  return {{"files", write_stereo_images(config, scene(), out, wish, progress).files}};
}

}  // namespace holdfast::sim
