// SPDX-License-Identifier: Apache-2.0
// The virtual robot that steers the beam by compensated poses, and where its beam truly lands.
#pragma once

#include <chrono>
#include <filesystem>
#include <string>

#include <Eigen/Geometry>

#include "tests/sim/trajectory.hpp"

namespace holdfast::sim {

/// A beam-steering stage as a linear actuator of two axes and depth, each alike: a dead time, then
/// x'' = wn^2 (u - x) - 2 zeta wn x'. The laser is on from `settling` after the permission came
/// until it ends; without one the stage stays where it is sent last.
struct BeamRobot {
  std::chrono::nanoseconds dead_time = std::chrono::milliseconds(1);
  double bandwidth_hz = 80;  ///< wn / 2 pi
  double damping = 0.7;
  std::chrono::nanoseconds settling = std::chrono::milliseconds(20);
  std::chrono::nanoseconds command_period = std::chrono::milliseconds(1);  ///< each is held so long
  /// By how much it follows a slow motion late: dead time + half a command + 2 zeta / wn.
  [[nodiscard]] std::chrono::nanoseconds lag() const noexcept;
};

struct BeamError {
  double on_s = 0;                            ///< the laser was on
  double on_share = 0;                        ///< of the time since it first was
  double rms_um = 0, p99_um = 0, max_um = 0;  ///< while on, across the optical axis
  double uncompensated_rms_um = 0;            ///< meanwhile, of a beam that stays where it was
  std::string rows;                           ///< CSV, one row a millisecond
};

/// `commands`: t_ns (from the sequence's start, rising), is_permitted (0, 1), and T_camera_site as
/// in poses.csv (tx_mm ... qw), empty while not permitted. `T_camera_ideal` and `depth_mm` as
/// tracking_error(). The target is the point of the optical axis at `depth_mm` at the start. NaN of
/// a laser that never was on. Throws InputError for a file that is none.
[[nodiscard]] BeamError beam_error(const std::filesystem::path& commands, const Trajectory& truth,
                                   const Eigen::Isometry3d& T_camera_ideal, double depth_mm,
                                   const BeamRobot& robot);

}  // namespace holdfast::sim
