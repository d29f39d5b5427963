// SPDX-License-Identifier: Apache-2.0
// Is the pattern in an image a lattice? Asked of the pixels of one view, before anything is
// matched: a lattice is alike a step further in at least two directions, everywhere; of an
// aperiodic pattern, half of whose places are empty, at most half is. So a surface that may have
// slipped by a period is refused even where the slip itself leaves no trace
// (pattern_repetition.hpp looks for that trace).
#pragma once

#include <opencv2/core.hpp>

#include "registration/worker_pool.hpp"

namespace holdfast::registration {

/// More is a lattice. Rendered ones, at any zoom and of any dots, lie between 0.66 and 1, images of
/// aperiodic and random patterns below 0.36 (`holdfast-study-reconstruct lattices`).
inline constexpr double kRepetitionMax = 0.45;

struct ImageRepetition {
  /// Of the texture's variance, the share that comes again one step further: median over the
  /// image's textured parts, at the step where it is largest; 0 … 1. 0 where no part of
  /// the image has texture.
  double share = 0;
  cv::Point2d step_px;  ///< that step
  int parts = 0;        ///< of the image that were judged, at the step's scale
};

/// Steps from 5 px (10 in a microscope's image) to an eighth of the image's smaller side, but no
/// less than 20 px: some 250 px in a microscope's. `image`: one view, raw or rectified, CV_8UC1.
/// Does not depend on the pool's number of threads.
[[nodiscard]] ImageRepetition repetition_of(const cv::Mat1b& image, WorkerPool& pool);

}  // namespace holdfast::registration
