// SPDX-License-Identifier: Apache-2.0
// Dense disparity of a rectified pair, with a variance per pixel. Census and semi-global matching
// on a pyramid (every candidate on the coarsest level, windows around its result on the finer
// ones), then least squares on the intensities, from the finest level matched to the finest one
// refined, and linear interpolation from there. OpenCV's SGBM, as paper A uses it,
// is the selectable baseline. Pixels that cannot be known are NaN, never filled.
#pragma once

#include <chrono>
#include <span>

#include <opencv2/core.hpp>

#include "registration/disparity_refinement.hpp"
#include "registration/pattern_repetition.hpp"
#include "registration/pixel_reason.hpp"
#include "registration/rectified_image.hpp"
#include "registration/sgm.hpp"

namespace holdfast::registration {

enum class MatchMethod {
  sgm,    ///< ours
  opencv  ///< cv::StereoSGBM, block 3, P1/P2 = 8/32·3², as paper A's baseline
};

/// Disparities minimum_px … minimum_px + count - 1; x_left - x_right, signed.
struct DisparityRange {
  int minimum_px = 0;
  int count = 144;
};

struct MatchParameters {
  MatchMethod method = MatchMethod::sgm;
  int coarsest_level = 2;  ///< halvings where every candidate is tried; 0 … 3
  int finest_level = 1;    ///< halvings of the last level that is matched; 0 … coarsest_level
  int refined_level = 1;   ///< halvings of the last level that is refined; 0 … finest_level
  sgm::Penalties penalties;
  double census_threshold_sigma = 2;  ///< in standard deviations of the noise
  int census_threshold_min = 0;       ///< grey levels, on every level: what the views differ by
  int margin_min = 8;                 ///< to the second-best candidate, of 255; less: unknown
  /// A neighbour further away than this many candidates of finest_level: a depth edge, where the
  /// window that was matched shows both surfaces; unknown.
  double edge_step_max = 1e9;
  int speckle_min_px = 400;   ///< smaller connected pieces (full-resolution pixels) are unknown
  double sigma_max_px = 0.8;  ///< predicted error; more: unknown
  bool is_explained = false;  ///< say of each pixel why it has a disparity or none
  RepetitionParameters repetition;
  RefinementParameters refinement;         ///< its pixels are those of refined_level
  RefinementParameters coarse_refinement;  ///< of the levels before that, likewise in their pixels
};

/// The parameters for images of this size. Large microscope images resolve no single pixel, and
/// between projected dots there is nothing to be matched in a small window: they are matched at a
/// quarter of the resolution and refined at half of it; small ones at their own.
[[nodiscard]] MatchParameters match_parameters_for(cv::Size image_px);

/// What the range becomes: count rounded up to whole blocks of the coarsest level, at most 8.
/// Throws InputError when the range is larger than that.
[[nodiscard]] DisparityRange whole_range(const MatchParameters& parameters, DisparityRange range);

/// The size that images must be padded to (right and below): whole pixels on the coarsest level.
[[nodiscard]] cv::Size padded_size(const MatchParameters& parameters, cv::Size size);

struct DisparityMap {
  cv::Mat1f disparity_px;  ///< NaN where unknown
  cv::Mat1f variance_px2;  ///< of the disparity; NaN where unknown
  cv::Mat1f confidence;    ///< 0 … 1: how far the best candidate was ahead of its rivals
  /// Of windows all over the scene, those that fit the other view nearly as well elsewhere on
  /// their rows (pattern_repetition.hpp): 1 for a lattice, 0 for a pattern that never repeats.
  double ambiguous_share = 0;
  cv::Mat1b reasons;  ///< PixelReason; empty unless is_explained
  std::chrono::nanoseconds match_time{0}, refine_time{0};
};

/// `pairs`: one, or several shots of one scene with different patterns or noise (a burst). All have
/// padded_size(); right views begin range.minimum_px + range.count - 1 columns left of left ones
/// and are range.count columns wider; `range` is whole. Not to be called by two threads at once on
/// one pool. Does not depend on the pool's number of threads.
[[nodiscard]] DisparityMap match_disparity(std::span<const RectifiedPair> pairs,
                                           DisparityRange range, const MatchParameters& parameters,
                                           WorkerPool& pool, Simd simd = best_simd());

}  // namespace holdfast::registration
