// SPDX-License-Identifier: Apache-2.0
// A tracking sequence: the left camera's middle, along a trajectory, kept once it is rendered.
#include <chrono>
#include <fstream>
#include <sstream>

#include <fmt/format.h>
#include <opencv2/imgproc.hpp>

#include "bridge/atomic_file.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/or/disturbance.hpp"
#include "tests/sim/or/ideal_calibration.hpp"
#include "tests/sim/or/room_files.hpp"
#include "tests/sim/or/room_output.hpp"
#include "tests/sim/or/sensor_noise.hpp"
#include "tests/sim/trajectory.hpp"

namespace holdfast::sim {
namespace {

using nlohmann::json;
namespace fs = std::filesystem;

constexpr int kWidthPx = 1920, kHeightPx = 1080;
constexpr const char* kStampName = ".holdfast_sequence";

std::string read_text(const fs::path& path) {
  std::ostringstream text;
  text << std::ifstream(path, std::ios::binary).rdbuf();
  return text.str();
}

// Everything the frames depend on, as a text.
std::string stamp_of(const RoomConfig& config, std::size_t frames) {
  std::string stamp =
      fmt::format("renderer {}, {} frames\n{}", kRendererVersion, frames, config.text);
  if (config.pattern == "file") {
    const std::string bytes = read_text(config.pattern_file);
    stamp += fmt::format("\npattern {:016x}", std::hash<std::string>{}(bytes));
  }
  return stamp;
}

fs::path frame_path(const fs::path& out, std::size_t frame) {
  return out / fmt::format("frame_{:05}.png", frame);
}

bool is_cached(const fs::path& out, const std::string& stamp, std::size_t frames) {
  if (read_text(out / kStampName) != stamp || !fs::exists(out / "timestamps.csv")) return false;
  for (std::size_t i = 0; i < frames; ++i)
    if (!fs::exists(frame_path(out, i))) return false;
  return true;
}

// The phantoms' looks have one albedo in the visible; a colour camera sees it tinted.
cv::Mat coloured(const cv::Mat& grey) {
  cv::Mat planes[3];
  grey.convertTo(planes[0], CV_8U, 0.78);
  grey.convertTo(planes[1], CV_8U, 0.86);
  grey.convertTo(planes[2], CV_8U, 1.0);
  cv::Mat colour;
  cv::merge(planes, 3, colour);
  return colour;
}

// As Renderer::image(), with what disturbs it at `t_s`.
cv::Mat disturbed_image(Renderer& renderer, RoomShot shot, const Microscope& microscope,
                        const Disturbances& disturbances, const Eigen::Isometry3d& T_ct_head_first,
                        double t_s, std::uint32_t visit) {
  if (disturbances.is_empty()) return renderer.image(shot, Side::left);
  if (const auto zoom = disturbances.zoom(t_s)) shot.optics = microscope.at(*zoom, visit);
  disturbances.set(shot, t_s);
  cv::Mat_<float> light = renderer.light(shot, Side::left);
  const Eigen::Isometry3d& T_head_camera = shot.optics.T_head_left;
  disturbances.draw(
      light,
      {shot, renderer.depth_mm(), shot.T_ct_head * T_head_camera, T_ct_head_first * T_head_camera},
      t_s);
  return exposed(light, shot.sensor, std::uint64_t{shot.seed} << 1U);
}

Eigen::Isometry3d as_isometry(const SitePose& pose) {
  return Eigen::Translation3d(pose.t_mm) * pose.q;
}

}  // namespace

RoomFiles write_sequence(const RoomConfig& config, const fs::path& out, const Progress& progress) {
  RoomScene scene(config);
  return write_sequence(config, scene, out, progress);
}

RoomFiles write_sequence(const RoomConfig& config, RoomScene& scene, const fs::path& out,
                         const Progress& progress) {
  const Microscope microscope(config.optics);
  const Trajectory trajectory(config.motion, config.motion_scale, false, microscope.focus_mm());
  const Disturbances disturbances(config.disturbances);
  const double seconds = std::chrono::duration<double>(trajectory.duration()).count();
  const auto frames = static_cast<std::size_t>(
      std::clamp(seconds * config.frame_rate_hz + 1, 1.0, static_cast<double>(config.frames_max)));
  const IdealCalibration ideal = ideal_calibration(microscope.at(config.zoom));
  const Eigen::Isometry3d T_ct_head =
      head_poses(config, scene.phantom, microscope.focus_mm()).front();
  const Eigen::Isometry3d T_site_ct = ideal.T_camera_head * T_ct_head.inverse();
  const std::string stamp = stamp_of(config, frames);
  make_folder(out);
  const bool is_there = is_cached(out, stamp, frames);
  std::error_code ignored;
  if (!is_there) fs::remove(out / kStampName, ignored);

  const ProjectorOptics projector = make_projector(config.optics.seed, microscope.focus_mm());
  RoomShot shot;
  shot.optics = microscope.at(config.zoom, config.visit);
  shot.lights = lights_of(config, projector);
  shot.projector = projector;
  shot.sensor = config.sensor;
  shot.region = {(kSensorWidthPx - kWidthPx) / 2, (kSensorHeightPx - kHeightPx) / 2, kWidthPx,
                 kHeightPx};
  RoomFiles files;
  json poses = json::array();
  std::string times = "frame,t_ns\n";
  for (std::size_t i = 0; i < frames; ++i) {
    const std::chrono::nanoseconds t{
        std::llround(1e9 * static_cast<double>(i) / config.frame_rate_hz)};
    const Eigen::Isometry3d T_camera_site = as_isometry(trajectory.at(t));
    poses.push_back({{"frame", i}, {"t_ns", t.count()}, {"T_camera_site", as_json(T_camera_site)}});
    times += fmt::format("{},{}\n", i, t.count());
    if (is_there) continue;
    shot.T_ct_head = (T_camera_site * T_site_ct).inverse() * ideal.T_camera_head;
    shot.seed = config.seed * 1'000'003U + 500'000U + static_cast<std::uint32_t>(i);
    const cv::Mat image = disturbed_image(scene.renderer, shot, microscope, disturbances,
                                          T_site_ct.inverse() * ideal.T_camera_head,
                                          std::chrono::duration<double>(t).count(), config.visit);
    write_image(frame_path(out, i), config.is_colour ? coloured(image) : image);
    ++files.files;
    progress(static_cast<int>(i) + 1, static_cast<int>(frames));
  }
  if (!is_there) {
    bridge::write_file_atomically((out / "timestamps.csv").string(), times);
    bridge::write_file_atomically((out / kStampName).string(), stamp);
    ++files.files;
  }
  files.frames = static_cast<int>(frames);
  files.region_px = shot.region;
  files.truth = json{
      {"what", "sequence"},
      {"zoom", config.zoom},
      {"region_px", {shot.region.x, shot.region.y, kWidthPx, kHeightPx}},
      {"ideal", as_json(ideal.model)},
      {"T_camera_ct", as_json(T_site_ct)},
      {"poses",
       poses}}.dump(1);
  return files;
}

}  // namespace holdfast::sim
