// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/room_server.hpp"

#include <cmath>
#include <string>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "bridge/depth_file.hpp"
#include "registration/stereo_calibration.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/or/ct_scanner.hpp"
#include "tests/sim/or/depth_error.hpp"
#include "tests/sim/or/dicom_series.hpp"

namespace holdfast::sim {
namespace {

using nlohmann::json;

template <typename Value>
Value member(const json& request, const char* name) {
  try {
    return request.at(name).get<Value>();
  } catch (const json::exception&) {
    throw InputError(fmt::format("request {}: no such member '{}'", request.dump(), name));
  }
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
                             config, scene, member<int>(request, "pose")));
}

}  // namespace

RoomScene& RoomServer::scene_of(const RoomConfig& config) {
  const std::string name = fmt::format("{} {}", config.phantom, config.phantom_seed);
  if (!scene_ || name != scene_name_) {
    scene_ = std::make_unique<RoomScene>(config);
    scene_name_ = name;
  }
  return *scene_;
}

json RoomServer::answer(const json& request, const Progress& progress) {
  const auto what = member<std::string>(request, "do");
  const RoomConfig config = read_room_config(member<std::string>(request, "config"));
  if (what == "depth-error") return error_of(request, config, scene_of(config));
  const auto out = member<std::string>(request, "out");
  if (what == "calibration")
    return {{"files", write_calibration_images(config, out, progress).files}};
  if (what == "stereo") {
    StereoWish wish{member<int>(request, "pose"), {}};
    if (request.contains("off_or_light"))
      wish.off_or_light = member<double>(request, "off_or_light");
    return {{"files", write_stereo_images(config, scene_of(config), out, wish, progress).files}};
  }
  if (what != "ct") throw InputError(fmt::format("request {}: 'do' is unknown", request.dump()));
  const CtVolume volume = scan(scene_of(config).phantom, {});
  return {{"files", write_dicom_series(volume, {}, out).files.size()}};
}

}  // namespace holdfast::sim
