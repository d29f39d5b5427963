// SPDX-License-Identifier: Apache-2.0
// What paper A leaves as future work: the next pattern, changed where the surface under the last
// one is unknown or uncertain, by what is wrong there. Shown to the same unmoved scene, both pairs
// are one burst. Nothing here is a depth: what is guessed in a hole only aims the projector.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include <opencv2/core.hpp>

#include "registration/pattern.hpp"
#include "registration/projector_map.hpp"
#include "registration/reconstruction.hpp"

namespace holdfast::registration {

/// Of a square of the pattern, kNeedCellPx on a side.
enum class PatternNeed : std::uint8_t {
  none,       ///< its surface is known well, or the left camera does not see it
  gap,        ///< poor, and the pattern had few dots there: dots where there were none
  faint,      ///< poor, though there were dots: little is left of their contrast: larger dots
  saturated,  ///< poor, and overexposed: dots of half the light
  other       ///< poor with dots that are well seen (edges, one view hidden): as `gap`
};
constexpr int kNeedCellPx = 8;
constexpr std::size_t kNeeds = 5;

struct PatternNeeds {
  cv::Mat1b cells;  ///< PatternNeed, 75x100
  std::array<int, kNeeds> count{};
};

struct NeedParameters {
  double sigma_max_mm = 0.15;  ///< predicted depth error; more is poor
  double poor_share = 0.2;     ///< of what is seen of a square
  double gap_share = 0.6;      ///< of the pattern's usual contrast; less is a gap
  double faint_share = 0.5;    ///< of the contrast usual for so much of a pattern
  double saturated_share = 0.05;
};

/// What one pair showed, and where its pattern came from.
struct SeenPattern {
  const Reconstruction& surface;  ///< done, with its reasons (is_explained)
  const Rectification& geometry;
  const cv::Mat1b& left;    ///< on the whole rectified left grid
  const cv::Mat1b& before;  ///< the pattern that was projected, 600x800
  const ProjectorMap& map;  ///< found
};

[[nodiscard]] PatternNeeds pattern_needs(const SeenPattern& seen,
                                         const NeedParameters& parameters = {});

/// What is projected in squares of each need: dots and gaps so much larger than elsewhere, and so
/// bright.
struct RefinementActions {
  std::array<double, kNeeds> scale{1, 1, 1.6, 1, 1};
  std::array<int, kNeeds> grey{255, 255, 255, 128, 255};
};

/// As many dots as make_pattern(next), but where `before` had none: what one of the two leaves dark
/// the other lights. In squares with a need, as `actions` say. Precondition: `next` is aperiodic
/// and not invalid_pattern(); sizes are scaled within its limits.
[[nodiscard]] cv::Mat refined_pattern(const PatternParameters& next, const cv::Mat1b& before,
                                      const PatternNeeds& needs,
                                      const RefinementActions& actions = {});

/// refined_pattern() without needs: the second of two that light everything once, for a burst.
[[nodiscard]] cv::Mat complementary_pattern(const PatternParameters& next, const cv::Mat1b& before);

}  // namespace holdfast::registration
