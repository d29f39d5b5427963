// SPDX-License-Identifier: Apache-2.0
// Matching of binary descriptors by Hamming distance with cross-check and ratio test. OpenCV's
// BFMatcher is built without POPCNT and takes ten times as long.
#pragma once

#include <vector>

#include "perception/features.hpp"

namespace holdfast::perception {

struct Match {
  int first = 0, second = 0;  ///< index of the feature in either set
  int distance = 0;           ///< bits
};

/// Every feature of one set against every feature of the other. A match is each other's best, at
/// most distance_max, and below ratio_max of the runner-up from both sides: a scene that repeats
/// itself yields few matches, not wrong ones. Ordered by `first`.
[[nodiscard]] std::vector<Match> match_all(const Features& first, const Features& second,
                                           const MatchParameters& parameters);

/// The same, but feature i of `first` only against features of `second` within the search radius of
/// `predicted[i]` (px; NaN: not searched).
[[nodiscard]] std::vector<Match> match_near(const Features& first,
                                            const std::vector<cv::Point2d>& predicted,
                                            const Features& second,
                                            const MatchParameters& parameters);

}  // namespace holdfast::perception
