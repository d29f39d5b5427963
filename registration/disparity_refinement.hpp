// SPDX-License-Identifier: Apache-2.0
// Sub-pixel disparity by local least squares on the intensities. Every pixel of a window is looked
// up in the right image at its own, smoothed disparity (so that windows follow slanted and curved
// surfaces); one correction and one brightness offset are then fitted to the window:
//   left(p) - gain·right(p + offset(p)) = correction · gradient(p) + brightness.
// A parabola through matching costs pulls towards whole pixels; this does not. The variance is
// measured, not assumed: it is how the sums of gradient·residual over blocks scatter around the
// fit, over the fit's information squared (a sandwich estimate that holds under correlated noise
// and where the surface does not fit the window), and what the prior may have kept uncorrected.
#pragma once

#include <cstdint>
#include <span>

#include <opencv2/core.hpp>

#include "registration/simd.hpp"
#include "registration/worker_pool.hpp"

namespace holdfast::registration {

constexpr std::int32_t kNoOffset = -1;

/// One shot: CV_8UC1, same rows; right column = left column + offset.
struct ShotPair {
  cv::Mat1b left, right;
};

struct RefinementParameters {
  int radius_px = 6;            ///< windows are 2·radius + 1 pixels wide and high; 2 … 10
  int iterations = 2;           ///< smooth, fit
  float start_near_px = 0.75F;  ///< of the start: see smooth_row; above its quantisation
  float prior_sigma_px = 0.5F;  ///< of the smoothed start: corrections are drawn to 0 by it
  float step_max_px = 1.F;      ///< a larger correction: not the minimum that was searched for
  float support_min = 0.3F;     ///< share of the window's pixels that have a match
};

struct RefinedOffsets {
  cv::Mat1f offset_px;     ///< NaN where unknown
  cv::Mat1f variance_px2;  ///< NaN where unknown
};

/// Brings `offset_256ths` (CV_32SC1, 1/256 px, kNoOffset where unknown) to sub-pixel accuracy.
/// Several shots of one scene are fitted together. Same result for any number of threads.
void refine_offsets(std::span<const ShotPair> shots, const cv::Mat1i& offset_256ths,
                    const RefinementParameters& parameters, WorkerPool& pool, RefinedOffsets& out,
                    Simd simd = best_simd());

}  // namespace holdfast::registration
