// SPDX-License-Identifier: Apache-2.0
// Could the matches be a period off? A pattern that repeats along the rows fits the other view
// again a period further, and every neighbour agrees on the wrong place: no check between
// neighbours sees it. This one asks of the scene, in windows that hold many dots and follow the
// matched surface, whether the views fit as well anywhere else along the rows.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "registration/disparity_refinement.hpp"
#include "registration/worker_pool.hpp"

namespace holdfast::registration {

struct RepetitionParameters {
  int radius_px = 30;  ///< of the windows
  int step_px = 3;     ///< between a window's samples
  int grid_px = 48;    ///< between windows
  /// The rival's unexplained variance over the match's own, and the correlation it must reach.
  double unexplained_ratio_max = 4, correlation_min = 0.6;
};

/// One window: how well the views correlate where they were matched, and at the best other place.
struct WindowFit {
  cv::Rect cell_px;               ///< the part of the image that it stands for
  double matched = 0, rival = 0;  ///< correlation, at most 1
  int rival_offset_px = 0;        ///< of the rival against the match
  bool is_ambiguous = false;
};

struct Repetition {
  std::vector<WindowFit> windows;
  double ambiguous_share = 1;  ///< of the windows that correlate at all; 1 where none does
};

/// `offset_px`: as refine_offsets() gives them (NaN unknown). Rivals are searched up to `reach_px`
/// on either side of the match, wherever the search itself ended: a slip may have left the truth
/// outside. Several shots must all repeat. Does not depend on the pool's number of threads.
[[nodiscard]] Repetition pattern_repetition(std::span<const ShotPair> shots,
                                            const cv::Mat1f& offset_px, int reach_px,
                                            const RepetitionParameters& parameters,
                                            WorkerPool& pool);

}  // namespace holdfast::registration
