// SPDX-License-Identifier: Apache-2.0
// holdfast-guard's configuration and its loop: reads the daemon's and the robot's topics, asks
// GuardCore, publishes the answer, strokes the watchdog.
#pragma once

#include <filesystem>
#include <string>

#include "bridge/security_config.hpp"
#include "rt/guard/guard_core.hpp"

namespace holdfast::guard {

struct GuardConfig {
  int domain = 0;
  bridge::SecurityConfig security;
  Eigen::Isometry3d T_robot_camera = Eigen::Isometry3d::Identity();
  GuardLimits limits;
  nanoseconds permission_validity = milliseconds(10);  ///< how long a robot may rely on one answer
  int priority = 85;            ///< SCHED_FIFO, above the daemon's threads; 0: ordinary
  bool allow_non_rt = false;    ///< go on without it
  std::string watchdog_device;  ///< empty: none
};

/// Annotated example: config/guard.toml. Throws InputError naming file, line, column, key, value.
[[nodiscard]] GuardConfig load_guard_config(const std::filesystem::path& file);

/// Until SIGINT or SIGTERM; then it withdraws its permission. Throws UnavailableError.
void run_guard(const GuardConfig& config);

}  // namespace holdfast::guard
