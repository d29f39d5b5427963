// SPDX-License-Identifier: Apache-2.0
#include "rt/daemon_config.hpp"

#include <cmath>

#include <fmt/format.h>

#include "bridge/camera_file.hpp"
#include "bridge/config_file.hpp"
#include "bridge/recorder/segment_folder.hpp"
#include "rt/core/error.hpp"
#include "rt/robot_place.hpp"

namespace holdfast::rt {
namespace {

using bridge::ConfigSection;
using bridge::Range;

constexpr Range kPriority{1, 98};

LoopParameters read_loop(const ConfigSection& section) {
  LoopParameters loop;
  loop.period = section.duration("period_us", loop.period, {250, 10'000});
  loop.publish_phase = section.duration("publish_phase_us", loop.publish_phase, {0, 5'000});
  loop.control_priority = section.integer("control_priority", loop.control_priority, kPriority);
  loop.publish_priority = section.integer("publish_priority", loop.publish_priority, kPriority);
  loop.optics_priority = section.integer("optics_priority", loop.optics_priority, kPriority);
  loop.tracker_priority = section.integer("tracker_priority", loop.tracker_priority, {0, 98});
  if (section.has("control_cpu")) loop.control_cpu = section.integer("control_cpu", 0, {0, 1023});
  loop.allow_non_rt = section.boolean("allow_non_rt", loop.allow_non_rt);
  if (loop.publish_phase >= loop.period)
    throw InputError(
        fmt::format("{} is not below the loop's period", section.where("publish_phase_us")));
  if (loop.publish_priority >= loop.control_priority)
    throw InputError(
        fmt::format("{} is not below control_priority", section.where("publish_priority")));
  return loop;
}

bridge::PixelFormat read_pixel_format(const ConfigSection& section) {
  using bridge::PixelFormat;
  static const std::vector<std::pair<std::string, PixelFormat>> formats = {
      {"Mono8", PixelFormat::mono8},        {"Mono12", PixelFormat::mono12},
      {"BayerRG8", PixelFormat::bayer_rg8}, {"BayerGB8", PixelFormat::bayer_gb8},
      {"BayerGR8", PixelFormat::bayer_gr8}, {"BayerBG8", PixelFormat::bayer_bg8},
      {"RGB8", PixelFormat::rgb8},          {"BGR8", PixelFormat::bgr8}};
  std::vector<std::string> names;
  for (const auto& [format_name, format] : formats) names.push_back(format_name);
  const std::string chosen = section.choice("pixel_format", "Mono8", names);
  for (const auto& [format_name, format] : formats)
    if (format_name == chosen) return format;
  return PixelFormat::mono8;
}

bridge::CameraParameters read_camera(const ConfigSection& section) {
  bridge::CameraParameters camera;
  camera.id = section.text("id", "");
  camera.serial = section.text("serial", "");
  camera.pixel_format = read_pixel_format(section);
  camera.width_px = section.integer("width_px", camera.width_px, {64, 16'384});
  camera.height_px = section.integer("height_px", camera.height_px, {64, 16'384});
  camera.offset_x_px = section.integer("offset_x_px", 0, {0, 16'384});
  camera.offset_y_px = section.integer("offset_y_px", 0, {0, 16'384});
  camera.frame_rate_hz = section.number("frame_rate_hz", camera.frame_rate_hz, {1, 500});
  camera.exposure_us = section.number("exposure_us", camera.exposure_us, {1, 1e6});
  if (section.has("gain_db")) camera.gain_db = section.number("gain_db", 0, {-20, 60});
  if (section.has("packet_size_bytes"))
    camera.packet_size_bytes = section.integer("packet_size_bytes", 1400, {576, 16'000});
  camera.buffers = section.integer("buffers", camera.buffers, {3, 64});
  camera.readout_delay = std::chrono::duration_cast<std::chrono::microseconds>(
      section.duration("readout_delay_us", camera.readout_delay, {0, 50'000}));
  camera.stamp_is_exposure_start =
      section.boolean("stamp_is_exposure_start", camera.stamp_is_exposure_start);
  if (camera.exposure_us * camera.frame_rate_hz >= 1e6)
    throw InputError(fmt::format("{} = {} is longer than a frame at {} hz",
                                 section.where("exposure_us"), camera.exposure_us,
                                 camera.frame_rate_hz));
  return camera;
}

bridge::FrameCheckLimits read_frame_check(const ConfigSection& section) {
  bridge::FrameCheckLimits check;
  check.dark_level = section.integer("dark_level", check.dark_level, {0, 255});
  check.dark_fraction_max = section.number("dark_fraction_max", check.dark_fraction_max, {0.01, 1});
  check.saturated_level = section.integer("saturated_level", check.saturated_level, {0, 255});
  check.saturated_fraction_max =
      section.number("saturated_fraction_max", check.saturated_fraction_max, {0.01, 1});
  return check;
}

perception::TrackerParameters read_tracker(const ConfigSection& section) {
  perception::TrackerParameters tracker;
  tracker.features.count = section.integer("features", tracker.features.count, {100, 10'000});
  tracker.features.fast_threshold =
      section.integer("fast_threshold", tracker.features.fast_threshold, {1, 100});
  tracker.uncertainty.relief_sigma_mm =
      section.number("relief_sigma_mm", tracker.uncertainty.relief_sigma_mm, {0, 20});
  tracker.uncertainty.depth_sigma_mm =
      section.number("depth_sigma_mm", tracker.uncertainty.depth_sigma_mm, {0, 20});
  tracker.mask.is_enabled = section.boolean("reflection_mask", tracker.mask.is_enabled);
  // Off unless asked for: how true they are is shown with exact depth only.
  tracker.ties.keyframes_max = section.integer("tied_keyframes", 0, {0, 16});
  return tracker;
}

PoseFilterParameters read_filter(const ConfigSection& section) {
  PoseFilterParameters filter;
  filter.acceleration_density_mm2_per_s3 = section.number(
      "acceleration_density_mm2_per_s3", filter.acceleration_density_mm2_per_s3, {1, 1e6});
  filter.angular_acceleration_density_rad2_per_s3 =
      section.number("angular_acceleration_density_rad2_per_s3",
                     filter.angular_acceleration_density_rad2_per_s3, {1e-6, 1e3});
  filter.innovation_gate_sigma =
      section.number("innovation_gate_sigma", filter.innovation_gate_sigma, {3, 20});
  filter.gap_max = section.duration("gap_max_ms", filter.gap_max, {10, 2'000});
  return filter;
}

safety::Limits read_limits(const ConfigSection& section, double frame_rate_hz) {
  safety::Limits limits;
  limits.frame_period = safety::Duration{std::llround(1e9 / frame_rate_hz)};
  limits.frame_lateness = section.duration("frame_lateness_ms", limits.frame_lateness, {0.5, 200});
  limits.estimate_age_max =
      section.duration("estimate_age_max_ms", limits.estimate_age_max, {5, 500});
  limits.pose_validity = section.duration("pose_validity_ms", limits.pose_validity, {2, 20});
  limits.pose_lead = section.duration("pose_lead_ms", limits.pose_lead, {0, 10});
  limits.robot_silence_max =
      section.duration("robot_silence_max_ms", limits.robot_silence_max, {10, 1'000});
  limits.loop_lateness_max =
      section.duration("loop_lateness_max_ms", limits.loop_lateness_max, {0.01, 20});
  limits.clock_step_max = section.duration("clock_step_max_ms", limits.clock_step_max, {0.1, 50});
  limits.hold_max = section.duration("hold_max_ms", limits.hold_max, {10, 5'000});
  limits.hold_recovery = section.duration("hold_recovery_ms", limits.hold_recovery, {1, 2'000});
  limits.drift_max_mm = section.number("drift_max_mm", limits.drift_max_mm, {0.01, 2});
  limits.displacement_max_mm =
      section.number("displacement_max_mm", limits.displacement_max_mm, {0.1, 50});
  limits.rotation_max_rad = section.number("rotation_max_rad", limits.rotation_max_rad, {0.01, 1});
  limits.speed_max_mm_per_s =
      section.number("speed_max_mm_per_s", limits.speed_max_mm_per_s, {0.1, 500});
  limits.sigma_target_max_mm =
      section.number("sigma_target_max_mm", limits.sigma_target_max_mm, {0.005, 2});
  limits.zoom_tolerance = section.number("zoom_tolerance", limits.zoom_tolerance, {0.0001, 0.1});
  limits.focus_tolerance_mm =
      section.number("focus_tolerance_mm", limits.focus_tolerance_mm, {0.001, 10});
  limits.scale_mismatch_max =
      section.number("scale_mismatch_max", limits.scale_mismatch_max, {0.001, 0.2});
  limits.optics_age_max = section.duration("optics_age_max_ms", limits.optics_age_max, {5, 500});
  limits.inliers_min = section.integer("inliers_min", limits.inliers_min, {6, 5'000});
  limits.inlier_spread_min =
      section.number("inlier_spread_min", limits.inlier_spread_min, {0.01, 1});
  return limits;
}

/// The encoders, or the word that nobody can turn the optics: nobody gets the latter by leaving a
/// line out.
OpticsParameters read_optics(const ConfigSection& section) {
  OpticsParameters optics;
  optics.interface = section.text("interface", "");
  if (section.has("local")) optics.local = section.path("local");
  if (section.has("optics")) optics.are_fixed = section.choice("optics", "", {"fixed"}) == "fixed";
  const int sources = (optics.interface.empty() ? 0 : 1) + (optics.local.empty() ? 0 : 1) +
                      (optics.are_fixed ? 1 : 0);
  if (sources != 1)
    throw InputError(
        fmt::format("{}: give the CAN interface of the microscope, or local = the path of a "
                    "virtual one's bus, or optics = \"fixed\" when nobody can turn zoom and focus",
                    section.where("interface")));
  bridge::can::MicroscopeParameters& node = optics.microscope;
  node.node = static_cast<std::uint8_t>(section.integer("node", node.node, {1, 127}));
  node.is_fd = section.boolean("fd", node.is_fd);
  node.heartbeat_period =
      section.duration("heartbeat_period_ms", node.heartbeat_period, {1, 1'000});
  node.state_period = section.duration("state_period_ms", node.state_period, {1, 1'000});
  return optics;
}

std::optional<RecorderConfig> read_recorder(const ConfigSection& root) {
  if (!root.has("recorder")) return std::nullopt;
  const ConfigSection section = root.section("recorder");
  constexpr std::uint64_t kMegabyte = 1'000'000;
  RecorderConfig recorder;
  recorder.folder = section.path("folder");
  const int size_mb = section.integer(
      "size_max_mb", static_cast<int>(recorder.size_max_bytes / kMegabyte), {32, 1'000'000});
  recorder.size_max_bytes = static_cast<std::uint64_t>(size_mb) * kMegabyte;
  if (const auto what = bridge::invalid_recording_folder(recorder.folder))
    throw InputError(fmt::format("{}: {}", section.where("folder"), *what));
  return recorder;
}

std::optional<LiveViewConfig> read_live_view(const ConfigSection& root) {
  if (!root.has("live_view")) return std::nullopt;
  const ConfigSection section = root.section("live_view");
  LiveViewConfig live;
  live.file = section.path("file");
  live.width_max_px = section.integer("width_max_px", live.width_max_px, {64, 1280});
  // Slower, a picture would be too old to be shown before the next one comes.
  live.rate_max_hz = section.number("rate_max_hz", live.rate_max_hz, {5, 60});
  if (const auto what = bridge::invalid_live_file(live.file))
    throw InputError(fmt::format("{}: {}", section.where("file"), *what));
  return live;
}

/// The target the file states, else the first one that the registration was judged at.
Eigen::Vector3d target_of(const ConfigSection& section, const std::vector<double>& stated,
                          const registration::Registration& registration) {
  if (!stated.empty()) return {stated[0], stated[1], stated[2]};
  if (registration.tre.empty())
    throw InputError(fmt::format("{} is missing, and the registration states no target",
                                 section.where("target_ct_mm")));
  return registration.tre.front().p_target_ct_mm;
}

void require_same_size(const DaemonConfig& config, const std::string& where) {
  if (config.calibration.width_px != config.camera.width_px ||
      config.calibration.height_px != config.camera.height_px)
    throw InputError(
        fmt::format("{}: the calibration is for {}x{} px, the camera is set to {}x{} px", where,
                    config.calibration.width_px, config.calibration.height_px,
                    config.camera.width_px, config.camera.height_px));
}

}  // namespace

DaemonConfig load_daemon_config(const std::filesystem::path& file) {
  const bridge::ConfigFile document{file};
  const ConfigSection root = document.root();
  DaemonConfig config;
  config.domain = root.section("dds").integer("domain", 0, {0, 230});
  config.security = bridge::read_security(root.section("dds"));
  config.loop = read_loop(root.section("loop"));
  config.camera = read_camera(root.section("camera"));
  config.frame_check = read_frame_check(root.section("frame_check"));
  config.tracker = read_tracker(root.section("tracker"));
  config.site_model =
      root.section("tracker").choice("site", "depth", {"depth", "planar"}) == "planar"
          ? SiteModel::planar
          : SiteModel::depth;
  config.optics = read_optics(root.section("microscope"));
  config.filter = read_filter(root.section("filter"));
  config.limits = read_limits(root.section("safety"), config.camera.frame_rate_hz);
  RobotPlace robot = read_robot_place(root.section("robot"));
  config.recorder = read_recorder(root);
  config.live_view = read_live_view(root);
  const ConfigSection registration = root.section("registration");
  const std::filesystem::path calibration_file = root.section("camera").path("calibration");
  const std::filesystem::path registration_file = registration.path("file");
  const auto stated_target = registration.numbers("target_ct_mm", {}, 3, {-2'000, 2'000});
  document.refuse_unknown_keys();
  // Only now: a key that is spelled wrong should not show as a contradiction with a default.
  if (const auto invalid = perception::invalid_parameter(config.tracker))
    throw InputError(fmt::format("{}: {}", root.where("tracker"), *invalid));
  if (const auto invalid = safety::invalid_limit(config.limits))
    throw InputError(fmt::format("{}: {}", root.where("safety"), *invalid));
  config.calibration = bridge::read_camera_file(calibration_file.string());
  require_same_size(config, root.section("camera").where("calibration"));
  config.registration = registration::load_registration(registration_file);
  if (config.registration.keyframe.empty() || config.registration.depth.empty())
    throw InputError(fmt::format("{}: carries no {}: there is nothing to track against",
                                 registration_file.string(),
                                 config.registration.keyframe.empty() ? "keyframe" : "depth"));
  if (!config.optics.are_fixed &&
      !(config.registration.zoom > 0 && config.registration.focus_mm > 0))
    throw InputError(fmt::format("{}: states no zoom and focus_mm to hold the microscope's against",
                                 registration_file.string()));
  load_robot_place(robot, config.calibration, config.registration, config.limits);
  config.T_robot_camera = robot.T_robot_camera;
  config.hand_eye_sigma = robot.sigma;
  config.p_target_ct_mm = target_of(registration, stated_target, config.registration);
  return config;
}

}  // namespace holdfast::rt
