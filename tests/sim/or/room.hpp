// SPDX-License-Identifier: Apache-2.0
// The virtual operating room as one configuration file describes it (config/or.toml): phantom,
// microscope, lights, pattern, poses, faults.
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <Eigen/Geometry>

#include "tests/sim/or/board.hpp"
#include "tests/sim/or/lights.hpp"
#include "tests/sim/or/optics.hpp"
#include "tests/sim/or/phantom.hpp"
#include "tests/sim/or/renderer.hpp"

namespace holdfast::sim {

struct RoomConfig {
  std::uint32_t seed = 1;

  std::string phantom = "ear";  ///< ear, cavity_bone, cavity_covered, cavity_bloody, relief
  std::uint32_t phantom_seed = 1;

  OpticsParameters optics;
  double zoom = 1.3;
  std::uint32_t visit = 1;  ///< how the zoom happens to be seated
  SensorParameters sensor;

  Lights lights;                 ///< its pattern is filled in by prepare_pattern()
  std::string pattern = "none";  ///< none, diffractive, or file
  std::filesystem::path pattern_file;
  double off_or_light = -1;  ///< or_light of the frames without the pattern; negative: as with it
  int diffractive_dots = 6000;
  double diffractive_dot_mm = 0.5;

  int poses = 1;  ///< the first is straight above the site
  double pose_tilt_rad = 0.12, pose_roll_rad = 0.1, pose_shift_mm = 3, pose_lift_mm = 2;

  std::vector<double> calibration_zooms{1.1, 1.2, 1.3, 1.4, 1.5};
  int calibration_held_out_sets = 0;
  Board board;
  BoardPoses board_poses;
  double calibration_or_light = 0.45;

  std::string motion = "spiral:0.2";
  std::string disturbances;  ///< of a sequence (Disturbances); empty: none
  double motion_scale = 1;
  double frame_rate_hz = 30;
  int frames_max = 300;
  bool is_colour = false;

  struct Faults {
    bool swaps_sides = false;  ///< left and right images change places
    int missing_right = -1;    ///< this pair's right image is not written
    int smeared_view = -1;     ///< this view of every calibration set is out of focus by 30 mm
    bool has_similar_views = false;  ///< every view of a calibration set is nearly the first
  } faults;

  std::string text;  ///< the file as read: what a cached sequence is known by
};

/// Throws InputError naming file, line, key, value and limit.
[[nodiscard]] RoomConfig read_room_config(const std::filesystem::path& file);

/// The phantom that the configuration names; throws as the makers do.
[[nodiscard]] Phantom make_phantom(const RoomConfig& config);

/// T_ct_head of each pose; the first looks along the phantom's view onto its focus.
[[nodiscard]] std::vector<Eigen::Isometry3d> head_poses(const RoomConfig& config,
                                                        const Phantom& phantom, double focus_mm);

/// Lights with the pattern read or made, 800x600 or a whole multiple. Throws InputError.
[[nodiscard]] Lights lights_of(const RoomConfig& config, const ProjectorOptics& projector);

/// How zoom number `index` is seated while the boards of set number `set` are before it.
[[nodiscard]] constexpr std::uint32_t board_visit(int set, std::size_t index) {
  return static_cast<std::uint32_t>(1000 + 100 * set) + static_cast<std::uint32_t>(index);
}

}  // namespace holdfast::sim
