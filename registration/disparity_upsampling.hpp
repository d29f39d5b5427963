// SPDX-License-Identifier: Apache-2.0
// Offsets of one level of the pyramid on finer ones: linear between its pixels, but never across a
// depth edge; what is unknown stays so.
#pragma once

#include <opencv2/core.hpp>

#include "registration/disparity_refinement.hpp"
#include "registration/simd.hpp"
#include "registration/worker_pool.hpp"

namespace holdfast::registration {

/// On the next finer level, twice as wide and high, as refine_offsets() takes them (1/256 px of
/// that level, kNoOffset where NaN).
void doubled(const cv::Mat1f& offset_px, WorkerPool& pool, cv::Mat1i& fine_256ths);

/// What is known of a level.
struct LevelOffsets {
  const RefinedOffsets& refined;
  const cv::Mat1b& margin;  ///< of the matcher, 0 … 255, on a level `margin_halvings` above
  int margin_halvings = 0;
};

struct UpsamplingParameters {
  int level = 0;            ///< of the offsets: the full grid is 2^level times as large
  float largest_px = 0;     ///< disparity = largest - offset, full-resolution px
  float variance_max = 0;   ///< px² of the level; more: unknown
  float clear_margin = 64;  ///< gives confidence 1
};

/// Rows of the full grid; all three as large. NaN (confidence 0) where unknown.
struct FullMaps {
  cv::Mat1f &disparity_px, &variance_px2, &confidence;
};

/// The full grid's maps, which must have their size. Same result for any number of threads.
void upsample(const LevelOffsets& from, const UpsamplingParameters& parameters, WorkerPool& pool,
              const FullMaps& out, Simd simd = best_simd());

}  // namespace holdfast::registration
