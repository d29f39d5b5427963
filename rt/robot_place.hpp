// SPDX-License-Identifier: Apache-2.0
// The daemon's [robot]: where the camera stands in the robot's frame, from `holdfast hand-eye`'s
// file or typed, with what is not known of it. Nothing stands in for either.
#pragma once

#include <filesystem>
#include <string>

#include <Eigen/Geometry>

#include "bridge/config_file.hpp"
#include "perception/camera_model.hpp"
#include "registration/registration_file.hpp"
#include "safety/gate.hpp"
#include "safety/limits.hpp"

namespace holdfast::rt {

struct RobotPlace {
  std::filesystem::path hand_eye;  ///< empty: typed
  std::string where;               ///< of its key in the configuration
  Eigen::Isometry3d T_robot_camera = Eigen::Isometry3d::Identity();
  safety::HandEyeSigma sigma;
};

/// `hand_eye`, or `translation_mm`, `rotation_xyzw`, `sigma_t_mm` and `sigma_r_rad`; no file is
/// opened. Throws InputError when neither is given, both are, or a part is missing.
[[nodiscard]] RobotPlace read_robot_place(const bridge::ConfigSection& robot);

/// Reads the hand-eye file, if one is named, and holds it against what it is used with. Throws
/// InputError when it is damaged, or was made at another zoom or focus than the registration
/// (tolerances of `limits`), for another image size, or with a camera calibration that places a
/// pixel more than 0.1 mm elsewhere at the working distance.
void load_robot_place(RobotPlace& place, const perception::CameraModel& camera,
                      const registration::Registration& registration, const safety::Limits& limits);

}  // namespace holdfast::rt
