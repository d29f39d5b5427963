// SPDX-License-Identifier: Apache-2.0
// A chessboard to calibrate with, as workshops make them: on a plate that is not quite flat.
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Geometry>

#include "tests/sim/or/optics.hpp"
#include "tests/sim/or/phantom.hpp"

namespace holdfast::sim {

/// Frame `board`: origin at the first inner corner, x along the rows, y along the columns, z into
/// the plate, as OpenCV's samples have it.
struct Board {
  int corners_x = 9, corners_y = 5;  ///< inner ones
  double square_mm = 3;
  double margin_mm = 3;    ///< white, around the squares
  double bow_mm = 0.008;   ///< how far the plate departs from a plane, at most
  std::uint32_t seed = 1;  ///< shapes the bow

  /// Height of the plate over its plane at a point of it, along -z.
  [[nodiscard]] double height_mm(double x_mm, double y_mm) const;
  /// Where the inner corners truly are, row by row, frame board.
  [[nodiscard]] std::vector<Eigen::Vector3d> corners() const;
  [[nodiscard]] LitSurface surface() const;
};

struct BoardPoses {
  int count = 19;
  double tilt_max_rad = 1.05;  ///< 60 degrees
  double depth_range_mm = 10;  ///< of the board's centre about the focal plane, each way
  double border_px = 25;       ///< the whole board stays this far inside both images
  std::uint32_t seed = 1;
};

/// T_head_board of each view: spread over the field, the tilts over their range, all in full view
/// of both cameras. Throws InputError when the board does not fit the field.
[[nodiscard]] std::vector<Eigen::Isometry3d> board_poses(const Board& board,
                                                         const StereoOptics& optics,
                                                         const BoardPoses& poses);

}  // namespace holdfast::sim
