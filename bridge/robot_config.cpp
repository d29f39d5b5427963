// SPDX-License-Identifier: Apache-2.0
#include "bridge/robot_config.hpp"

#include <cmath>

#include <fmt/format.h>

#include "rt/core/error.hpp"

namespace holdfast::bridge {

Eigen::Isometry3d read_robot_camera(const ConfigSection& robot) {
  constexpr double kUnitTolerance = 1e-3;
  if (!robot.has("translation_mm") || !robot.has("rotation_xyzw"))
    throw InputError(
        fmt::format("{} and rotation_xyzw are required: without T_robot_camera no pose can be "
                    "given or judged; `holdfast hand-eye` measures it",
                    robot.where("translation_mm")));
  const auto t = robot.numbers("translation_mm", {}, 3, {-5'000, 5'000});
  const auto q = robot.numbers("rotation_xyzw", {}, 4, {-1, 1});
  const Eigen::Quaterniond rotation{q[3], q[0], q[1], q[2]};
  if (!(std::abs(rotation.norm() - 1) < kUnitTolerance))
    throw InputError(fmt::format("{} has norm {}, not 1 within {}", robot.where("rotation_xyzw"),
                                 rotation.norm(), kUnitTolerance));
  return Eigen::Translation3d{t[0], t[1], t[2]} * rotation.normalized();
}

}  // namespace holdfast::bridge
