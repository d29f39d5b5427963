// SPDX-License-Identifier: Apache-2.0
// The inner loops of semi-global matching, one image row at a time, over blocks of 16 candidates.
//
// Paths are kept as gains, not costs: of a pixel's candidates, G = max(0, P2 - (L - min L)), where
// L is the path's cost (Hirschmueller's L_r). With
//   T(j) = max(G_before(j), G_before(j-1) - P1, G_before(j+1) - P1, 0)
// the path's cost is L(j) = C(j) + P2 - T(j) up to a constant of the pixel. A zero gain says
// "nothing known", so that candidates outside a neighbour's window need no special case, and the
// sum of five paths with their costs fits 8 bits.
#pragma once

#include <cstdint>

#include "registration/simd.hpp"

namespace holdfast::registration::sgm {

constexpr int kBlock = 16;     ///< candidates in a block
constexpr int kBlocksMax = 8;  ///< blocks of one pixel
constexpr int kCostMax = 20;   ///< the census cost is cut here: random words differ in 15.5 bits
constexpr int kPaths = 5;      ///< from the left, right, above, above left, above right

struct Penalties {
  std::uint8_t p1 = 7;   ///< a step of one candidate
  std::uint8_t p2 = 24;  ///< any other step; p1 < p2 <= 31
};

/// A row's layout. Candidates of pixel x are columns x + base[x] + j of the right row,
/// 0 <= j < 16·blocks. Pixels are padded to an even width.
struct Row {
  int width;   ///< even
  int blocks;  ///< 1 … kBlocksMax; 1 where there are bases
  /// Per pixel; null: all zero. Pixels 2i and 2i + 1 need not agree.
  const std::int16_t* base;
};

/// Gains of the three paths that come from the row above; (width + 2)·16·blocks each, one pixel of
/// zeros at both ends.
struct Gains {
  std::uint8_t *down, *down_right, *down_left;
};

/// What the sums say of a pixel.
struct Choice {
  std::int16_t* candidate_16ths;  ///< base + best j, with a parabola's fraction; in 1/16
  std::uint8_t* cost;             ///< of the best, 0 (perfect) … 255
  std::uint8_t* margin;           ///< to the best that is not its neighbour (saturated)
};

/// cost[x·16·blocks + j] = min(differing bits, kCostMax).
void cost_row(const Row& row, const std::int32_t* left, const std::int32_t* right,
              std::uint8_t* cost, Simd simd);

/// The gains T of the two paths along the row, into `sum` (overwritten).
void aggregate_along(const Row& row, const std::uint8_t* cost, Penalties penalties,
                     std::uint8_t* sum, Simd simd);

/// Adds the T of the three paths from above to `sum`, and leaves their gains in `now`.
/// `before_base`: the bases of the row above.
void aggregate_down(const Row& row, const std::int16_t* before_base, const std::uint8_t* cost,
                    Penalties penalties, const Gains& before, const Gains& now, std::uint8_t* sum,
                    Simd simd);

/// The best candidate of each pixel, by the sum of path gains and costs.
void choose(const Row& row, const std::uint8_t* cost, const std::uint8_t* sum, const Choice& out,
            Simd simd);

}  // namespace holdfast::registration::sgm
