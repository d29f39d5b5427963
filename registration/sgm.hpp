// SPDX-License-Identifier: Apache-2.0
// Semi-global matching of one level of the pyramid: five paths (as OpenCV's SGBM), every candidate
// or a window of 16 around a guess, rows in fixed bands, so that the result does not depend on the
// number of threads.
#pragma once

#include <opencv2/core.hpp>

#include "registration/sgm_rows.hpp"
#include "registration/simd.hpp"
#include "registration/worker_pool.hpp"

namespace holdfast::registration::sgm {

constexpr std::int16_t kNone = -1;  ///< of a pixel without a consistent match

struct LevelResult {
  cv::Mat1s candidate_16ths;  ///< right column - left column, in 1/16 px; kNone where unknown
  cv::Mat1b cost;             ///< of the chosen candidate, 0 … 255
  cv::Mat1b margin;           ///< to the best candidate that is no neighbour of it
};

/// Census images of one height; `right` is wider than `left` by at least 16·blocks - 1, and pixel
/// (x, y)'s candidates are (x + j, y), 0 <= j < 16·blocks. `left` has an even width.
/// `base`: CV_16SC1 like `left`, the first candidate of each pixel's window (blocks is then how far
/// windows may reach), or empty: all candidates.
/// Left-right check: of the pixels that choose one right pixel only the best keeps it.
void match_level(const cv::Mat1i& left, const cv::Mat1i& right, int blocks, const cv::Mat1s& base,
                 Penalties penalties, WorkerPool& pool, LevelResult& out, Simd simd = best_simd());

/// Windows for the next finer level (twice as wide and high; `fine_size` is even), around each
/// pixel's candidate, or around its neighbourhood's where that spans less than the window. Where
/// nothing is known, the background's: its neighbour in the row with the smaller disparity.
void search_windows(const cv::Mat1s& candidate_16ths, cv::Size fine_size, int fine_candidates,
                    WorkerPool& pool, cv::Mat1s& base);

}  // namespace holdfast::registration::sgm
