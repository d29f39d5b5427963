// SPDX-License-Identifier: Apache-2.0
// The inner loops of disparity_refinement, one row at a time.
#pragma once

#include <cstdint>

#include "registration/simd.hpp"

namespace holdfast::registration::refinement {

constexpr int kScale = 8;  ///< residuals and gradients are kept as integers of 1/8 grey level

/// Residual and gradient of every pixel of a row; both 0 where `is_used` is 0.
struct Residuals {
  std::int16_t *residual, *gradient, *is_used;
};

struct Images {
  const std::uint8_t *left, *right;  ///< one row
  int width, right_width;
  float gain;  ///< left over right
};

/// Sums over a column or a window of one row's pixels, one array each.
struct Sums {
  std::int32_t *gg, *gr, *rr, *g, *r, *n;
};

/// What the fits need, summed over the shots: centred sums of gradient² , gradient·residual and
/// residual², and the number of pixels.
struct Moments {
  float *gg, *gr, *rr, *n;
};

struct Limits {
  float prior_weight;  ///< 1 / prior_sigma²
  float step_max_px;
  float n_min;
  float gradient_noise;  ///< what noise alone adds to gradient², a pixel
};

/// How the window's fit turns an error of its scores (gradient times what the fit leaves) into one
/// of the offset, and what the prior may have kept from being corrected.
struct Sensitivity {
  float* per_score;  ///< gradient² / information²: times the scores' variance a gradient², px²
  float* of_start_px2;  ///< variance that is left of the start's
};

/// What a fit's scores are judged by, added up over the shots.
struct Scores {
  std::int32_t* score;   ///< gradient times what the fit leaves, centred in the window
  std::int32_t* energy;  ///< centred gradient²
};

constexpr int kBlockRadiusPx = 2;  ///< scores are summed over blocks of 5x5: longer than residuals
                                   ///< of resampled images are correlated

/// sum += sign·offset and count += sign where the offset is known (not negative).
void add_offsets(const std::int32_t* offset_256ths, int width, int sign, std::int32_t* sum,
                 std::int32_t* count, Simd simd);
/// The window's mean in px; a pixel's own value where that is further than `near_px` from it (a
/// depth edge); NaN where it is unknown or has fewer than `least` neighbours.
void smooth_row(const std::int32_t* offset_256ths, const std::int32_t* sum,
                const std::int32_t* count, int width, int least, float near_px, float* out_px,
                Simd simd);
/// `offset_px` in 1/256 px; -1 where NaN or negative.
void quantise_row(const float* offset_px, int width, std::int32_t* out_256ths, Simd simd);

/// `offset_px`: right column - left column, NaN where unknown. Cubic interpolation.
void residual_row(const Images& images, const float* offset_px, const Residuals& out, Simd simd);
/// sums += row's products (sign +1) or -= (sign -1).
void add_products(const Residuals& row, int width, int sign, const Sums& sums, Simd simd);
/// out[x] = in[x - radius] + … + in[x + radius], nothing beyond the ends. `scratch`: 3·(width +
/// 64).
void window_sum(const std::int32_t* in, int width, int radius, std::int32_t* scratch,
                std::int32_t* out, Simd simd);
/// moments += the centred window sums.
void add_moments(const Sums& sums, int width, const Moments& moments, Simd simd);
/// offset_px += correction; NaN where the fit fails.
void solve_row(const Moments& moments, int width, const Limits& limits, float* offset_px,
               const Sensitivity& out, Simd simd);
/// Adds gradient·(residual - correction·gradient) of a row, centred in each pixel's window
/// (`window`: its sums), and gradient²; nothing where `fitted_px` is NaN.
void add_scores(const Residuals& row, const Sums& window, const float* start_px,
                const float* fitted_px, int width, const Scores& scores, Simd simd);
/// The squares of a row of block sums, in units of kSquareUnit.
void square_row(const std::int32_t* blocks, int width, std::int32_t* out, Simd simd);
constexpr float kSquareUnit = 256;
/// (fitted - start)² in 1/256² px²; -1 where the fit failed.
void moved_row(const float* start_px, const float* fitted_px, int width, std::int32_t* out,
               Simd simd);

/// Sums over a window around each pixel: of square_row, of gradient², of moved_row, and of how many
/// pixels.
struct Scatter {
  const std::int32_t *squares, *energy, *moved, *count;
};
/// The variance of the offsets. `freedom`: the share of the scores' variance that a fit leaves.
/// Scores scatter as their gradients do: measured around a fit's own window too, where dots may lie
/// that it has none of, they count by gradient² and not by pixel.
void variance_row(const Scatter& scatter, const Sensitivity& sensitivity, float freedom, int width,
                  float* variance_px2, Simd simd);

}  // namespace holdfast::registration::refinement
