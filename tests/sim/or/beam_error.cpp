// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/beam_error.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>
#include <optional>
#include <vector>

#include <fmt/format.h>

#include "rt/core/error.hpp"
#include "tests/sim/csv_table.hpp"

namespace holdfast::sim {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;
using std::chrono::nanoseconds;

constexpr nanoseconds kStep = std::chrono::microseconds(20);

struct Command {
  nanoseconds t{};
  std::optional<Vector3d> p_target_mm;  ///< none: not permitted
};

std::vector<Command> read_commands(const std::filesystem::path& file, const Vector3d& p_site_mm) {
  const CsvTable table(file);
  const std::size_t t = table.column("t_ns"), permitted = table.column("is_permitted");
  std::vector<std::size_t> pose;
  for (const char* name : {"tx_mm", "ty_mm", "tz_mm", "qw", "qx", "qy", "qz"})
    pose.push_back(table.column(name));
  std::vector<Command> commands;
  for (std::size_t row = 0; row < table.rows(); ++row) {
    Command command{nanoseconds(table.integer(row, t)), {}};
    if (table.integer(row, permitted) == 1) {
      const auto v = [&](std::size_t k) { return table.number(row, pose[k]); };
      const Eigen::Quaterniond q(v(3), v(4), v(5), v(6));
      command.p_target_mm = q * p_site_mm + Vector3d(v(0), v(1), v(2));
    }
    if ((command.p_target_mm && !command.p_target_mm->allFinite()) ||
        (!commands.empty() && command.t <= commands.back().t))
      throw InputError(fmt::format("{}: row {}: is no command", file.string(), row + 1));
    commands.push_back(command);
  }
  if (commands.empty()) throw InputError(file.string() + ": has no command");
  return commands;
}

/// The stage at one instant.
struct Stage {
  Vector3d p_mm, v_mm_per_s = Vector3d::Zero();
  void move(const Vector3d& wanted_mm, const BeamRobot& robot) {
    const double wn = 2 * std::numbers::pi * robot.bandwidth_hz;
    const double dt = std::chrono::duration<double>(kStep).count();
    v_mm_per_s += dt * (wn * wn * (wanted_mm - p_mm) - 2 * robot.damping * wn * v_mm_per_s);
    p_mm += dt * v_mm_per_s;
  }
};

double rms(const std::vector<double>& values) {
  const double squares = std::inner_product(values.begin(), values.end(), values.begin(), 0.0);
  return std::sqrt(squares / static_cast<double>(values.size()));
}

}  // namespace

nanoseconds BeamRobot::lag() const noexcept {
  const double second_order_s = damping / (std::numbers::pi * bandwidth_hz);
  return dead_time + command_period / 2 + nanoseconds(std::llround(1e9 * second_order_s));
}

BeamError beam_error(const std::filesystem::path& file, const Trajectory& truth,
                     const Isometry3d& T_camera_ideal, double depth_mm, const BeamRobot& robot) {
  const Vector3d p_start = T_camera_ideal * Vector3d(0, 0, depth_mm);
  const std::vector<Command> commands = read_commands(file, p_start);
  const auto p_target = [&](nanoseconds t) -> Vector3d {
    const SitePose pose = truth.at(t);
    return T_camera_ideal * (pose.q * Vector3d(0, 0, depth_mm) + pose.t_mm);
  };
  BeamError result;
  result.rows = "t_ns,is_on,x_um,y_um,beam_x_um,beam_y_um\n";
  std::vector<double> errors_um, still_um;
  Stage stage{p_start};
  Vector3d wanted_mm = p_start;
  bool is_permitted = false;
  nanoseconds t_permitted{};  // since when
  std::size_t next_seen = 0, next_felt = 0;
  int milliseconds_since_on = 0;
  for (nanoseconds t = commands.front().t; t <= commands.back().t; t += kStep) {
    for (; next_seen < commands.size() && commands[next_seen].t <= t; ++next_seen) {
      const bool was_permitted = is_permitted;
      is_permitted = commands[next_seen].p_target_mm.has_value();
      if (!was_permitted) t_permitted = t;
    }
    for (; next_felt < commands.size() && commands[next_felt].t + robot.dead_time <= t; ++next_felt)
      wanted_mm = commands[next_felt].p_target_mm.value_or(wanted_mm);
    const Vector3d p_beam_mm = stage.p_mm;
    stage.move(wanted_mm, robot);
    if ((t - commands.front().t) % std::chrono::milliseconds(1) != nanoseconds(0)) continue;
    const bool is_on = is_permitted && t - t_permitted >= robot.settling;
    const Vector3d moved_um = 1000 * (p_target(t) - p_start);
    const Vector3d beam_um = 1000 * (p_beam_mm - p_start);
    if (is_on) {
      errors_um.push_back((beam_um - moved_um).head<2>().norm());
      still_um.push_back(moved_um.head<2>().norm());
    }
    if (!errors_um.empty()) ++milliseconds_since_on;
    result.rows += fmt::format("{},{:d},{:.3f},{:.3f},{:.3f},{:.3f}\n", t.count(), is_on,
                               moved_um.x(), moved_um.y(), beam_um.x(), beam_um.y());
  }
  result.on_s = static_cast<double>(errors_um.size()) / 1000;
  if (errors_um.empty()) {
    result.rms_um = result.p99_um = result.max_um = result.uncompensated_rms_um =
        std::numeric_limits<double>::quiet_NaN();
    return result;
  }
  result.on_share = static_cast<double>(errors_um.size()) / milliseconds_since_on;
  result.rms_um = rms(errors_um);
  result.uncompensated_rms_um = rms(still_um);
  std::sort(errors_um.begin(), errors_um.end());
  result.max_um = errors_um.back();
  result.p99_um = errors_um[(errors_um.size() * 99) / 100];
  return result;
}

}  // namespace holdfast::sim
