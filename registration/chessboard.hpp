// SPDX-License-Identifier: Apache-2.0
// A chessboard's inner corners in one image, to a few hundredths of a pixel.
#pragma once

#include <optional>
#include <vector>

#include <opencv2/core.hpp>

#include "registration/calibration_views.hpp"

namespace holdfast::registration {

struct ChessboardView {
  std::vector<cv::Point2d> corners;  ///< px, row by row; empty: the whole board was not found
  /// Where it was not found: the columns and rows of what was (0x0: nothing like a board).
  cv::Size seen{0, 0};
};

/// Finds the board in a grey 8-bit image: coarsely on a reduced image, then every corner is fitted
/// with the model of two crossing blurred edges at full resolution. One thread a call; calls may
/// run at the same time.
[[nodiscard]] ChessboardView find_chessboard(const cv::Mat& grey, const BoardPattern& board);

/// Refines corners in place; a corner whose fit fails (no crossing of two edges within reach)
/// makes it return false. `reach_px`: half side of the window, shorter than half a square.
[[nodiscard]] bool refine_corners(const cv::Mat& grey, int reach_px,
                                  std::vector<cv::Point2d>& corners);

/// Numbers the right view's corners as the left's: a board that looks the same after half a turn
/// (odd by odd) may come out turned in one of them. The cameras see it from nearly the same side
/// and are not turned against one another by more than a quarter turn.
void match_corner_order(const BoardPattern& board, const std::vector<cv::Point2d>& left,
                        std::vector<cv::Point2d>& right);

}  // namespace holdfast::registration
