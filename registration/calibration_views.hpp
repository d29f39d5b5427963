// SPDX-License-Identifier: Apache-2.0
// What a stereo calibration is made from: the corners of one chessboard in pairs of images.
#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

namespace holdfast::registration {

struct BoardPattern {
  int columns = 9, rows = 5;  ///< inner corners
  double square_mm = 3;

  [[nodiscard]] int corners() const { return columns * rows; }
  /// The flat board, origin in its middle, row by row: x along the columns, y along the rows, mm.
  [[nodiscard]] std::vector<Eigen::Vector3d> points_mm() const;
};

/// One pose of the board, seen by both cameras; corner i is the same corner in both.
struct BoardPair {
  std::string name;                      ///< for messages: the left file
  std::vector<cv::Point2d> left, right;  ///< px, row by row
};

struct ZoomViews {
  double zoom = 0;
  std::vector<BoardPair> pairs;
};

}  // namespace holdfast::registration
