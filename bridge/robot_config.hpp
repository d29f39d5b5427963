// SPDX-License-Identifier: Apache-2.0
// Where the robot stands in relation to the camera, as a configuration file states it.
#pragma once

#include <Eigen/Geometry>

#include "bridge/config_file.hpp"

namespace holdfast::bridge {

/// T_robot_camera: `translation_mm` (3) and `rotation_xyzw` (a quaternion, its length 1 within
/// 1e-3) of `robot`. Throws InputError when either is missing, since nothing may stand in for it,
/// or out of range.
[[nodiscard]] Eigen::Isometry3d read_robot_camera(const ConfigSection& robot);

}  // namespace holdfast::bridge
