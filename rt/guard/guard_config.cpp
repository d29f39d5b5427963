// SPDX-License-Identifier: Apache-2.0
#include "bridge/config_file.hpp"
#include "bridge/robot_config.hpp"
#include "rt/core/error.hpp"
#include "rt/guard/guard.hpp"

namespace holdfast::guard {
namespace {

GuardLimits read_limits(const bridge::ConfigSection& s) {
  GuardLimits l;
  l.daemon_silence_max = s.duration("daemon_silence_max_ms", l.daemon_silence_max, {6, 20});
  l.pose_silence_max = s.duration("pose_silence_max_ms", l.pose_silence_max, {2, 20});
  l.pose_age_max = s.duration("pose_age_max_ms", l.pose_age_max, {10, 200});
  l.health_silence_max = s.duration("health_silence_max_ms", l.health_silence_max, {100, 1000});
  l.robot_silence_max = s.duration("robot_silence_max_ms", l.robot_silence_max, {20, 500});
  l.robot_obeys_within = s.duration("robot_obeys_within_ms", l.robot_obeys_within, {20, 500});
  l.recovery = s.duration("recovery_ms", l.recovery, {1, 1000});
  l.displacement_max_mm = s.number("displacement_max_mm", l.displacement_max_mm, {0.1, 50});
  l.rotation_max_rad = s.number("rotation_max_rad", l.rotation_max_rad, {0.001, 1});
  l.speed_max_mm_per_s = s.number("speed_max_mm_per_s", l.speed_max_mm_per_s, {1, 500});
  l.pose_step_max_mm = s.number("pose_step_max_mm", l.pose_step_max_mm, {0.01, 5});
  l.tracking_gap_max_mm = s.number("tracking_gap_max_mm", l.tracking_gap_max_mm, {0.1, 20});
  l.target_error_max_mm = s.number("target_error_max_mm", l.target_error_max_mm, {1e-6, 1});
  return l;
}

}  // namespace

GuardConfig load_guard_config(const std::filesystem::path& path) {
  const bridge::ConfigFile file(path);
  const auto root = file.root();
  GuardConfig config;
  config.domain = root.integer("domain", config.domain, {0, 230});
  config.permission_validity =
      root.duration("permission_validity_ms", config.permission_validity, {4, 20});
  config.priority = root.integer("priority", config.priority, {0, 99});
  config.allow_non_rt = root.boolean("allow_non_rt", config.allow_non_rt);
  config.security = bridge::read_security(root.section("dds"));
  config.T_robot_camera = bridge::read_robot_camera(root.section("robot"));
  config.limits = read_limits(root.section("limits"));
  config.watchdog_device = root.section("watchdog").text("device", "");
  file.refuse_unknown_keys();
  if (const std::string problem = invalid_limit(config.limits); !problem.empty())
    throw InputError(path.string() + ": limits: " + problem);
  return config;
}

}  // namespace holdfast::guard
