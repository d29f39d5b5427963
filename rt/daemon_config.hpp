// SPDX-License-Identifier: Apache-2.0
// Everything holdfastd is told, in one struct: read once, validated, then constant.
#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "bridge/camera_source.hpp"
#include "bridge/frame_check.hpp"
#include "bridge/security_config.hpp"
#include "perception/camera_model.hpp"
#include "perception/tracker_parameters.hpp"
#include "registration/registration_file.hpp"
#include "rt/live_view.hpp"
#include "rt/optics_thread.hpp"
#include "rt/pose_filter.hpp"
#include "rt/recorder_config.hpp"
#include "safety/gate.hpp"
#include "safety/limits.hpp"

namespace holdfast::rt {

enum class SiteModel : std::uint8_t {
  planar,  ///< the site is a plane at the depth map's value under the optical axis
  depth    ///< the site is the registration's depth map: full 6-DoF motion
};

struct LoopParameters {
  std::chrono::nanoseconds period = std::chrono::milliseconds(1);
  std::chrono::nanoseconds publish_phase =
      std::chrono::microseconds(250);  ///< after the control step
  int control_priority = 80;
  int publish_priority = 75;
  int optics_priority = 70;   ///< reading the microscope
  int tracker_priority = 40;  ///< 0: ordinary scheduling
  std::optional<int> control_cpu;
  bool allow_non_rt = false;  ///< go on, and say so in every health message
};

struct DaemonConfig {
  int domain = 0;
  bridge::SecurityConfig security;
  LoopParameters loop;
  bridge::CameraParameters camera;
  bridge::FrameCheckLimits frame_check;
  perception::CameraModel calibration;
  perception::TrackerParameters tracker;
  SiteModel site_model = SiteModel::depth;
  registration::Registration registration;
  OpticsParameters optics;
  Eigen::Vector3d p_target_ct_mm = Eigen::Vector3d::Zero();
  Eigen::Isometry3d T_robot_camera = Eigen::Isometry3d::Identity();
  safety::HandEyeSigma hand_eye_sigma;
  PoseFilterParameters filter;
  safety::Limits limits;
  std::optional<RecorderConfig> recorder;   ///< absent: nothing is recorded
  std::optional<LiveViewConfig> live_view;  ///< absent: no picture leaves the daemon
};

/// Reads `file` (annotated example: config/holdfastd.toml), the calibration and the registration
/// that it names, and checks all of it. Throws InputError naming file, line, column, key, value,
/// limit and unit.
[[nodiscard]] DaemonConfig load_daemon_config(const std::filesystem::path& file);

}  // namespace holdfast::rt
