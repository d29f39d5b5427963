// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/room_files.hpp"

#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "rt/core/error.hpp"
#include "tests/sim/or/ideal_calibration.hpp"
#include "tests/sim/or/room_output.hpp"

namespace holdfast::sim {
namespace {

using nlohmann::json;
namespace fs = std::filesystem;

std::string zoom_name(double zoom) {
  std::string name = fmt::format("{:.3f}", zoom);
  while (name.ends_with('0') && !name.ends_with(".0")) name.pop_back();
  return name;
}

// A pair of one view, swapped or incomplete where a fault says so.
void write_pair(const RoomConfig& config, const fs::path& left, const fs::path& right,
                const cv::Mat& image_left, const cv::Mat& image_right, int index, int& files) {
  const bool is_swapped = config.faults.swaps_sides;
  write_image(left, is_swapped ? image_right : image_left);
  ++files;
  if (config.faults.missing_right == index) return;
  write_image(right, is_swapped ? image_left : image_right);
  ++files;
}

std::uint32_t noise_seed(const RoomConfig& config, int set, int zoom, int view) {
  return config.seed * 1'000'003U + static_cast<std::uint32_t>((set * 100 + zoom) * 1000 + view);
}

struct CalibrationSet {
  int number;  // 0: the one to calibrate with
  fs::path folder;
};

json write_calibration_set(const RoomConfig& config, const Microscope& microscope,
                           Renderer& renderer, const CalibrationSet& set, RoomFiles& files,
                           const std::function<void()>& tick) {
  json zooms = json::array();
  for (std::size_t i = 0; i < config.calibration_zooms.size(); ++i) {
    const double zoom = config.calibration_zooms[i];
    const std::uint32_t visit = board_visit(set.number, i);
    BoardPoses wanted = config.board_poses;
    wanted.seed += static_cast<std::uint32_t>(7919 * set.number);
    RoomShot shot;
    shot.optics = microscope.at(zoom, visit);
    shot.sensor = config.sensor;
    shot.lights.or_light = config.calibration_or_light;
    std::vector<Eigen::Isometry3d> poses = board_poses(config.board, shot.optics, wanted);
    if (config.faults.has_similar_views)
      for (std::size_t k = 1; k < poses.size(); ++k)
        poses[k] = Eigen::Translation3d(0.02 * static_cast<double>(k), 0, 0) * poses[0];
    const fs::path folder = set.folder / ("zoom_" + zoom_name(zoom));
    make_folder(folder);
    json views = json::array();
    for (std::size_t k = 0; k < poses.size(); ++k) {
      const int view = static_cast<int>(k);
      Eigen::Isometry3d T_head_board = poses[k];
      if (config.faults.smeared_view == view) T_head_board.pretranslate(Eigen::Vector3d(0, 0, 30));
      shot.T_ct_head = T_head_board.inverse();
      shot.seed = noise_seed(config, set.number, static_cast<int>(i), view);
      const cv::Mat left = renderer.image(shot, Side::left),
                    right = renderer.image(shot, Side::right);
      write_pair(config, folder / fmt::format("left_{:02}.png", view),
                 folder / fmt::format("right_{:02}.png", view), left, right, view, files.files);
      views.push_back({{"T_head_board", as_json(T_head_board)}});
      tick();
    }
    const IdealCalibration ideal = ideal_calibration(microscope.at(zoom));
    zooms.push_back({{"zoom", zoom},
                     {"visit", visit},
                     {"views", views},
                     {"ideal", as_json(ideal.model)},
                     {"T_camera_head", as_json(ideal.T_camera_head)}});
  }
  return {{"set", set.number}, {"zooms", zooms}};
}

}  // namespace

RoomFiles write_calibration_images(const RoomConfig& config, const fs::path& out,
                                   const Progress& progress) {
  const Microscope microscope(config.optics);
  Renderer renderer({config.board.surface()}, -Eigen::Vector3d::UnitZ());
  const int sets = 1 + config.calibration_held_out_sets;
  const int all =
      sets * static_cast<int>(config.calibration_zooms.size()) * config.board_poses.count;
  int done = 0;
  RoomFiles files;
  json truth = json::array();
  for (int set = 0; set < sets; ++set) {
    const fs::path folder = set == 0 ? out : out / fmt::format("held_out_{}", set);
    truth.push_back(write_calibration_set(config, microscope, renderer, {set, folder}, files,
                                          [&] { progress(++done, all); }));
  }
  json corners = json::array();
  for (const Eigen::Vector3d& p : config.board.corners()) corners.push_back(as_json(p));
  files.truth = json{
      {"what", "calibration"},
      {"focus_mm", microscope.focus_mm()},
      {"board_corners", corners},
      {"sets",
       truth}}.dump(1);
  return files;
}

RoomScene::RoomScene(const RoomConfig& config)
    : phantom(make_phantom(config)), renderer(phantom.surfaces, phantom.n_view_ct) {}

RoomFiles write_stereo_images(const RoomConfig& config, const fs::path& out,
                              const Progress& progress) {
  RoomScene scene(config);
  return write_stereo_images(config, scene, out, {}, progress);
}

RoomFiles write_stereo_images(const RoomConfig& config, RoomScene& scene, const fs::path& out,
                              const StereoWish& wish, const Progress& progress) {
  const Microscope microscope(config.optics);
  const ProjectorOptics projector = make_projector(config.optics.seed, microscope.focus_mm());
  const IdealCalibration ideal = ideal_calibration(microscope.at(config.zoom));
  RoomShot shot;
  shot.optics = microscope.at(config.zoom, config.visit);
  shot.lights = lights_of(config, projector);
  shot.projector = projector;
  shot.sensor = config.sensor;
  const std::vector<Eigen::Isometry3d> poses =
      head_poses(config, scene.phantom, microscope.focus_mm());
  const int only = wish.only_pose.value_or(-1);
  if (wish.only_pose && (only < 0 || only >= config.poses))
    throw InputError(fmt::format("pose {}, must be 0 to {}", only, config.poses - 1));
  RoomFiles files;
  json truth = json::array();
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const int pose = static_cast<int>(i);
    if (only >= 0 && only != pose) continue;
    const bool is_alone = only >= 0 || poses.size() == 1;
    const fs::path folder = is_alone ? out : out / fmt::format("pose_{:02}", pose);
    make_folder(folder);
    shot.T_ct_head = poses[i];
    const auto pair = [&](const RoomShot& s, const char* suffix) {
      const cv::Mat left = scene.renderer.image(s, Side::left),
                    right = scene.renderer.image(s, Side::right);
      write_pair(config, folder / fmt::format("left{}.png", suffix),
                 folder / fmt::format("right{}.png", suffix), left, right, pose, files.files);
    };
    shot.seed = noise_seed(config, 200, 0, pose);
    pair(shot, "");
    if (wish.has_off && !shot.lights.pattern.empty()) {
      RoomShot off = shot;
      off.lights.pattern = cv::Mat();
      if (config.off_or_light >= 0) off.lights.or_light = config.off_or_light;
      if (wish.off_or_light) off.lights.or_light = *wish.off_or_light;
      off.seed = noise_seed(config, 201, 0, pose);
      pair(off, "_off");
    }
    const Eigen::Isometry3d T_camera_ct = ideal.T_camera_head * poses[i].inverse();
    truth.push_back({{"T_camera_ct", as_json(T_camera_ct)},
                     {"T_ct_head", as_json(poses[i])},
                     {"markers", markers_json(scene.phantom, T_camera_ct)}});
    progress(pose + 1, static_cast<int>(poses.size()));
  }
  files.truth = json{
      {"what", "stereo"},
      {"zoom", config.zoom},
      {"focus_mm", microscope.focus_mm()},
      {"phantom", scene.phantom.name},
      {"ideal", as_json(ideal.model)},
      {"poses",
       truth}}.dump(1);
  return files;
}

}  // namespace holdfast::sim
