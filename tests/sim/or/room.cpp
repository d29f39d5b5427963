// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/room.hpp"

#include <cmath>
#include <fstream>
#include <sstream>

#include <fmt/format.h>
#include <opencv2/imgproc.hpp>

#include "bridge/config_file.hpp"
#include "bridge/image_file.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/or/relief_phantom.hpp"
#include "tests/sim/or/seeded_random.hpp"

namespace holdfast::sim {
namespace {

using bridge::ConfigSection;
using Eigen::Vector3d;

constexpr double kSeedMax = 4294967295.0;

std::uint32_t seed_of(const ConfigSection& section, std::string_view key, std::uint32_t fallback) {
  return static_cast<std::uint32_t>(
      section.number(key, static_cast<double>(fallback), {0, kSeedMax}));
}

void read_microscope(const ConfigSection& s, RoomConfig& c) {
  OpticsParameters& o = c.optics;
  o.seed = seed_of(s, "seed", c.seed);
  c.zoom = s.number("zoom", c.zoom, {Microscope::kZoomMin, Microscope::kZoomMax});
  c.visit = seed_of(s, "visit", c.visit);
  o.irregularity = s.number("irregularity", o.irregularity, {0, 10});
  o.seating_px = s.number("seating_px", o.seating_px, {0, 5});
  o.seating_focal = s.number("seating_focal", o.seating_focal, {0, 0.01});
  o.aperture_mm = s.number("aperture_mm", o.aperture_mm, {0.1, 10});
  o.blur_px = s.number("blur_px", o.blur_px, {0.3, 5});
  o.exposure_mismatch = s.number("exposure_mismatch", o.exposure_mismatch, {0, 0.5});
}

void read_sensor(const ConfigSection& s, SensorParameters& sensor) {
  sensor.exposure = s.number("exposure", sensor.exposure, {0.001, 100});
  sensor.read_noise_dn = s.number("read_noise_dn", sensor.read_noise_dn, {0, 50});
  sensor.shot_noise_dn = s.number("shot_noise_dn", sensor.shot_noise_dn, {0, 5});
  sensor.bits = s.integer("bits", sensor.bits, {8, 12});
  if (sensor.bits != 8 && sensor.bits != 12)
    throw InputError(fmt::format("{} = {} is neither 8 nor 12", s.where("bits"), sensor.bits));
}

void read_lights(const ConfigSection& s, RoomConfig& c) {
  Lights& l = c.lights;
  l.or_light = s.number("or_light", l.or_light, {0, 10});
  l.microscope_light = s.number("microscope_light", l.microscope_light, {0, 10});
  c.pattern = s.choice("pattern", c.pattern, {"none", "diffractive", "file"});
  if (c.pattern == "file") c.pattern_file = s.path("pattern_file");
  l.pattern_power = s.number("pattern_power", l.pattern_power, {0, 10});
  l.speckle = s.number("speckle", l.speckle, {0, 1});
  l.scatter_mm = s.number("scatter_mm", l.scatter_mm, {-1, 5});
  c.off_or_light = s.number("pattern_off_or_light", c.off_or_light, {-1, 10});
  c.diffractive_dots = s.integer("diffractive_dots", c.diffractive_dots, {1, 100'000});
  c.diffractive_dot_mm = s.number("diffractive_dot_mm", c.diffractive_dot_mm, {0.05, 10});
}

void read_poses(const ConfigSection& s, RoomConfig& c) {
  c.poses = s.integer("count", c.poses, {1, 1000});
  c.pose_tilt_rad = s.number("tilt_rad", c.pose_tilt_rad, {0, 0.7});
  c.pose_roll_rad = s.number("roll_rad", c.pose_roll_rad, {0, 3.2});
  c.pose_shift_mm = s.number("shift_mm", c.pose_shift_mm, {0, 50});
  c.pose_lift_mm = s.number("lift_mm", c.pose_lift_mm, {0, 50});
}

void read_calibration(const ConfigSection& s, RoomConfig& c) {
  const double first = s.number("zoom_first", 1.1, {Microscope::kZoomMin, Microscope::kZoomMax});
  const double last = s.number("zoom_last", 1.5, {Microscope::kZoomMin, Microscope::kZoomMax});
  const int count = s.integer("zoom_count", 5, {1, 41});
  c.calibration_zooms.clear();
  for (int i = 0; i < count; ++i)
    c.calibration_zooms.push_back(count > 1 ? first + (last - first) * i / (count - 1) : first);
  c.calibration_held_out_sets = s.integer("held_out_sets", 0, {0, 100});
  c.calibration_or_light = s.number("or_light", c.calibration_or_light, {0, 10});
  Board& b = c.board;
  b.corners_x = s.integer("corners_x", b.corners_x, {3, 60});
  b.corners_y = s.integer("corners_y", b.corners_y, {3, 60});
  b.square_mm = s.number("square_mm", b.square_mm, {0.2, 30});
  b.bow_mm = s.number("bow_mm", b.bow_mm, {0, 2});
  b.seed = seed_of(s, "board_seed", c.seed);
  BoardPoses& p = c.board_poses;
  p.count = s.integer("pairs", p.count, {1, 500});
  p.tilt_max_rad = s.number("tilt_max_rad", p.tilt_max_rad, {0, 1.3});
  p.depth_range_mm = s.number("depth_range_mm", p.depth_range_mm, {0, 60});
  p.border_px = s.number("border_px", p.border_px, {-2000, 500});
  p.seed = seed_of(s, "pose_seed", c.seed);
}

void read_sequence(const ConfigSection& s, RoomConfig& c) {
  c.motion = s.text("motion", c.motion);
  c.motion_scale = s.number("motion_scale", c.motion_scale, {0, 100});
  c.frame_rate_hz = s.number("frame_rate_hz", c.frame_rate_hz, {0.1, 1000});
  c.frames_max = s.integer("frames_max", c.frames_max, {1, 100'000});
  c.is_colour = s.boolean("colour", c.is_colour);
}

void read_faults(const ConfigSection& s, RoomConfig::Faults& f) {
  f.swaps_sides = s.boolean("swap_sides", f.swaps_sides);
  f.missing_right = s.integer("missing_right", f.missing_right, {-1, 10'000});
  f.smeared_view = s.integer("smeared_view", f.smeared_view, {-1, 10'000});
  f.has_similar_views = s.boolean("similar_views", f.has_similar_views);
}

}  // namespace

RoomConfig read_room_config(const std::filesystem::path& path) {
  const bridge::ConfigFile file(path);
  const ConfigSection root = file.root();
  RoomConfig c;
  c.seed = seed_of(root, "seed", c.seed);
  const ConfigSection phantom = root.section("phantom");
  c.phantom = phantom.choice("kind", c.phantom,
                             {"ear", "cavity_bone", "cavity_covered", "cavity_bloody", "relief"});
  c.phantom_seed = seed_of(phantom, "seed", c.seed);
  read_microscope(root.section("microscope"), c);
  read_sensor(root.section("sensor"), c.sensor);
  read_lights(root.section("lights"), c);
  read_poses(root.section("poses"), c);
  read_calibration(root.section("calibration"), c);
  read_sequence(root.section("sequence"), c);
  read_faults(root.section("faults"), c.faults);
  file.refuse_unknown_keys();
  std::ostringstream text;
  text << std::ifstream(path).rdbuf();
  c.text = text.str();
  return c;
}

Phantom make_phantom(const RoomConfig& config) {
  if (config.phantom == "relief") return make_relief_phantom(config.phantom_seed);
  if (config.phantom == "ear") return make_ear_phantom(config.phantom_seed);
  if (config.phantom == "cavity_bone")
    return make_cavity_phantom(config.phantom_seed, CavityRealism::bone);
  if (config.phantom == "cavity_covered")
    return make_cavity_phantom(config.phantom_seed, CavityRealism::covered);
  return make_cavity_phantom(config.phantom_seed, CavityRealism::bloody);
}

std::vector<Eigen::Isometry3d> head_poses(const RoomConfig& config, const Phantom& phantom,
                                          double focus_mm) {
  const Vector3d z = -phantom.n_view_ct.normalized();
  const Vector3d x = (phantom.x_view_ct - z * z.dot(phantom.x_view_ct)).normalized();
  SeededRandom random{config.seed, 0x905e5U};
  const auto draw = [&random] { return random.between(-1, 1); };
  std::vector<Eigen::Isometry3d> poses;
  for (int i = 0; i < config.poses; ++i) {
    const double scale = i == 0 ? 0 : 1;
    Eigen::Isometry3d T_ct_head = Eigen::Isometry3d::Identity();
    T_ct_head.translation() = phantom.p_focus_ct_mm;
    T_ct_head.linear() << x, z.cross(x), z;
    const double tilt_x = draw(), tilt_y = draw(), roll = draw();
    const double shift_x = draw(), shift_y = draw(), lift = draw();
    T_ct_head.rotate(Eigen::AngleAxisd(scale * config.pose_tilt_rad * tilt_x, Vector3d::UnitX()));
    T_ct_head.rotate(Eigen::AngleAxisd(scale * config.pose_tilt_rad * tilt_y, Vector3d::UnitY()));
    T_ct_head.rotate(Eigen::AngleAxisd(scale * config.pose_roll_rad * roll, Vector3d::UnitZ()));
    T_ct_head.translate(Vector3d(scale * config.pose_shift_mm * shift_x,
                                 scale * config.pose_shift_mm * shift_y,
                                 scale * config.pose_lift_mm * lift - focus_mm));
    poses.push_back(T_ct_head);
  }
  return poses;
}

Lights lights_of(const RoomConfig& config, const ProjectorOptics& projector) {
  Lights lights = config.lights;
  if (config.pattern == "diffractive")
    lights.pattern = diffractive_dots(config.seed, config.diffractive_dots,
                                      config.diffractive_dot_mm, projector);
  if (config.pattern == "file") {
    lights.pattern = bridge::read_image_file(config.pattern_file.string());
    if (lights.pattern.channels() == 3)
      cv::cvtColor(lights.pattern, lights.pattern, cv::COLOR_BGR2GRAY);
    const cv::Mat& p = lights.pattern;
    if (p.type() != CV_8UC1 || p.cols % kProjectorWidthPx != 0 ||
        p.cols / kProjectorWidthPx * kProjectorHeightPx != p.rows)
      throw InputError(fmt::format("{}: {}x{} px, a pattern has 800x600 of 8 bit",
                                   config.pattern_file.string(), p.cols, p.rows));
  }
  return lights;
}

}  // namespace holdfast::sim
