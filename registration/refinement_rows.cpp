// SPDX-License-Identifier: Apache-2.0
#include "registration/refinement_rows.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include <immintrin.h>

// Plain loops that the compiler turns into vectors, once for each instruction set. Neither has
// fused multiply-add, so that both give the same bits.
#define HOLDFAST_INLINE inline __attribute__((always_inline))
#define HOLDFAST_AVX2 __attribute__((target("avx2")))

namespace holdfast::registration::refinement {
namespace {

constexpr std::uint8_t kSaturated = 254;
/// Catmull-Rom through four pixels: value and slope at `t` between the middle two.
struct Cubic {
  float value, slope;
};

Cubic cubic(float a, float b, float c, float d, float t) {
  const float c1 = 0.5F * (c - a), c2 = a - 2.5F * b + 2 * c - 0.5F * d;
  const float c3 = 0.5F * (d - a) + 1.5F * (b - c);
  return {((c3 * t + c2) * t + c1) * t + b, (3 * c3 * t + 2 * c2) * t + c1};
}

void residual_pixel(const Images& images, int x, float offset_px, const Residuals& out) {
  out.residual[x] = out.gradient[x] = out.is_used[x] = 0;
  const float at = static_cast<float>(x) + offset_px;
  const bool is_inside =
      at >= 1 && at < static_cast<float>(images.right_width - 3) && x > 0 && x < images.width - 1;
  if (!is_inside) return;
  const float column = std::floor(at);
  const std::uint8_t* const p = images.right + static_cast<int>(column) - 1;
  const std::uint8_t grey = images.left[x];
  if (grey >= kSaturated || p[1] >= kSaturated || p[2] >= kSaturated) return;
  const Cubic right = cubic(p[0], p[1], p[2], p[3], at - column);
  const float left_slope =
      0.5F * (static_cast<float>(images.left[x + 1]) - static_cast<float>(images.left[x - 1]));
  const float residual = static_cast<float>(grey) - images.gain * right.value;
  const float slope = 0.5F * (left_slope + images.gain * right.slope);
  out.residual[x] = static_cast<std::int16_t>(std::lrintf(kScale * residual));
  out.gradient[x] = static_cast<std::int16_t>(std::lrintf(kScale * slope));
  out.is_used[x] = 1;
}

HOLDFAST_AVX2 HOLDFAST_INLINE __m256 byte_of(__m256i words, int shift) {
  return _mm256_cvtepi32_ps(
      _mm256_and_si256(_mm256_srli_epi32(words, shift), _mm256_set1_epi32(255)));
}

HOLDFAST_AVX2 HOLDFAST_INLINE __m256i left_grey(const std::uint8_t* p) {
  return _mm256_cvtepu8_epi32(_mm_loadl_epi64(reinterpret_cast<const __m128i*>(p)));
}

HOLDFAST_AVX2 HOLDFAST_INLINE void store_words(__m256i words, std::int16_t* out) {
  _mm_storeu_si128(
      reinterpret_cast<__m128i*>(out),
      _mm_packs_epi32(_mm256_castsi256_si128(words), _mm256_extracti128_si256(words, 1)));
}

HOLDFAST_AVX2 HOLDFAST_INLINE __m256 constant(float v) {
  return _mm256_set1_ps(v);
}

/// Eight pixels from x on, x >= 1 and x + 8 < width.
HOLDFAST_AVX2 HOLDFAST_INLINE void residual_eight(const Images& images, int x,
                                                  const float* offset_px, const Residuals& out) {
  const __m256 columns =
      _mm256_add_ps(constant(static_cast<float>(x)), _mm256_setr_ps(0, 1, 2, 3, 4, 5, 6, 7));
  const __m256 at = _mm256_add_ps(columns, _mm256_loadu_ps(offset_px + x));
  const __m256 inside = _mm256_and_ps(
      _mm256_cmp_ps(at, constant(1), _CMP_GE_OQ),
      _mm256_cmp_ps(at, constant(static_cast<float>(images.right_width - 3)), _CMP_LT_OQ));
  const __m256 column = _mm256_floor_ps(at), t = _mm256_sub_ps(at, column);
  const __m256i index =
      _mm256_and_si256(_mm256_sub_epi32(_mm256_cvtps_epi32(column), _mm256_set1_epi32(1)),
                       _mm256_castps_si256(inside));
  const __m256i words =
      _mm256_i32gather_epi32(reinterpret_cast<const int*>(images.right), index, 1);
  const __m256 a = byte_of(words, 0), b = byte_of(words, 8), c = byte_of(words, 16),
               d = byte_of(words, 24);
  const __m256 half = constant(0.5F), gain = constant(images.gain);
  const __m256 c1 = _mm256_mul_ps(half, _mm256_sub_ps(c, a));
  const __m256 c2 = _mm256_sub_ps(_mm256_add_ps(_mm256_sub_ps(a, _mm256_mul_ps(constant(2.5F), b)),
                                                _mm256_mul_ps(constant(2), c)),
                                  _mm256_mul_ps(half, d));
  const __m256 c3 = _mm256_add_ps(_mm256_mul_ps(half, _mm256_sub_ps(d, a)),
                                  _mm256_mul_ps(constant(1.5F), _mm256_sub_ps(b, c)));
  const __m256 value = _mm256_add_ps(
      _mm256_mul_ps(_mm256_add_ps(_mm256_mul_ps(_mm256_add_ps(_mm256_mul_ps(c3, t), c2), t), c1),
                    t),
      b);
  const __m256 slope =
      _mm256_add_ps(_mm256_mul_ps(_mm256_add_ps(_mm256_mul_ps(_mm256_mul_ps(constant(3), c3), t),
                                                _mm256_mul_ps(constant(2), c2)),
                                  t),
                    c1);
  const __m256 grey = _mm256_cvtepi32_ps(left_grey(images.left + x));
  const __m256 left_slope =
      _mm256_mul_ps(half, _mm256_sub_ps(_mm256_cvtepi32_ps(left_grey(images.left + x + 1)),
                                        _mm256_cvtepi32_ps(left_grey(images.left + x - 1))));
  const __m256 brightest = _mm256_max_ps(grey, _mm256_max_ps(b, c));
  const __m256i used = _mm256_castps_si256(
      _mm256_and_ps(inside, _mm256_cmp_ps(brightest, constant(kSaturated), _CMP_LT_OQ)));
  const __m256 scale = constant(kScale);
  const __m256 residual = _mm256_mul_ps(scale, _mm256_sub_ps(grey, _mm256_mul_ps(gain, value)));
  const __m256 gradient = _mm256_mul_ps(
      scale, _mm256_mul_ps(half, _mm256_add_ps(left_slope, _mm256_mul_ps(gain, slope))));
  store_words(_mm256_and_si256(_mm256_cvtps_epi32(residual), used), out.residual + x);
  store_words(_mm256_and_si256(_mm256_cvtps_epi32(gradient), used), out.gradient + x);
  store_words(_mm256_srli_epi32(used, 31), out.is_used + x);
}

HOLDFAST_AVX2 void residual_row_avx2(const Images& images, const float* offset_px,
                                     const Residuals& out) {
  residual_pixel(images, 0, offset_px[0], out);
  int x = 1;
  for (; x + 9 <= images.width; x += 8) residual_eight(images, x, offset_px, out);
  for (; x < images.width; ++x) residual_pixel(images, x, offset_px[x], out);
}

HOLDFAST_INLINE void products(const Residuals& row, int width, int sign, const Sums& sums) {
  const std::int16_t *const g = row.gradient, *const r = row.residual, *const n = row.is_used;
#pragma GCC ivdep
  for (int x = 0; x < width; ++x) {
    sums.gg[x] += sign * (g[x] * g[x]);
    sums.gr[x] += sign * (g[x] * r[x]);
    sums.rr[x] += sign * (r[x] * r[x]);
    sums.g[x] += sign * g[x];
    sums.r[x] += sign * r[x];
    sums.n[x] += sign * n[x];
  }
}

/// Sums of 1, 2, 4, 8, … neighbours, put together to 2·radius + 1.
HOLDFAST_INLINE void windows(const std::int32_t* in, int width, int radius, std::int32_t* scratch,
                             std::int32_t* out) {
  const int length = 2 * radius + 1, padded = width + 2 * radius;
  std::int32_t *from = scratch, *to = scratch + padded + 16;
  std::fill_n(from, radius, 0);
  std::copy_n(in, width, from + radius);
  std::fill_n(from + radius + width, radius + 16, 0);
  for (int x = 0; x < width; ++x) out[x] = from[x];  // length is odd
  int done = 1;
  for (int step = 1; 2 * step <= length; step *= 2) {
#pragma GCC ivdep
    for (int x = 0; x < padded - step; ++x) to[x] = from[x] + from[x + step];
    std::fill_n(to + padded - step, step, 0);
    std::swap(from, to);
    if ((length & (2 * step)) == 0) continue;
#pragma GCC ivdep
    for (int x = 0; x < width; ++x) out[x] += from[x + done];
    done += 2 * step;
  }
}

HOLDFAST_INLINE void moments_row(const Sums& sums, int width, const Moments& moments) {
#pragma GCC ivdep
  for (int x = 0; x < width; ++x) {
    const float n = static_cast<float>(sums.n[x]), share = 1 / (n > 1 ? n : 1);
    const float g = static_cast<float>(sums.g[x]), r = static_cast<float>(sums.r[x]);
    moments.gg[x] += static_cast<float>(sums.gg[x]) - g * g * share;
    moments.gr[x] += static_cast<float>(sums.gr[x]) - g * r * share;
    moments.rr[x] += static_cast<float>(sums.rr[x]) - r * r * share;
    moments.n[x] += n;
  }
}

HOLDFAST_INLINE void solve(const Moments& moments, int width, const Limits& limits,
                           float* offset_px, const Sensitivity& out) {
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
#pragma GCC ivdep
  for (int x = 0; x < width; ++x) {
    const float gg = moments.gg[x] > 1 ? moments.gg[x] : 1;
    const float gr = moments.gr[x], rr = moments.rr[x];
    const float n = moments.n[x] > 4 ? moments.n[x] : 4;
    const float left_over = rr - gr * gr / gg;
    const float noise = (left_over > 1 ? left_over : 1) / (n - 2);  // per pixel, 1/64 grey²
    const float information = gg + limits.prior_weight * noise;
    // Noise has gradients too: they carry nothing and draw the fit towards its start. What is
    // missed of the start's error by that is part of the variance.
    const float texture = gg - moments.n[x] * limits.gradient_noise;
    const float missed = 1 - (texture > 0 ? texture : 0) / information;
    const float correction = gr / information;
    const bool is_good = offset_px[x] >= 0 && moments.n[x] >= limits.n_min &&
                         correction <= limits.step_max_px && correction >= -limits.step_max_px;
    offset_px[x] = is_good ? offset_px[x] + correction : kNan;
    out.per_score[x] = is_good ? gg / (information * information) : kNan;
    out.of_start_px2[x] = missed * missed / limits.prior_weight;
  }
}

HOLDFAST_INLINE void scores_row(const Residuals& row, const Sums& window, const float* start_px,
                                const float* fitted_px, int width, const Scores& scores) {
#pragma GCC ivdep
  for (int x = 0; x < width; ++x) {
    const float share = 1 / static_cast<float>(window.n[x] > 1 ? window.n[x] : 1);
    const float g = static_cast<float>(row.gradient[x]) - share * static_cast<float>(window.g[x]);
    const float r = static_cast<float>(row.residual[x]) - share * static_cast<float>(window.r[x]);
    const float correction = fitted_px[x] - start_px[x];
    const float score = g * (r - correction * g);
    const bool is_used = row.is_used[x] != 0 && correction == correction;
    scores.score[x] += static_cast<std::int32_t>(is_used ? score : 0.F);
    scores.energy[x] += static_cast<std::int32_t>(is_used ? g * g : 0.F);
  }
}

HOLDFAST_INLINE void squares(const std::int32_t* blocks, int width, std::int32_t* out) {
  constexpr std::int32_t kMost = 1800;  // its square, summed over 21x21 windows, stays in 31 bits
#pragma GCC ivdep
  for (int x = 0; x < width; ++x) {
    const std::int32_t block = blocks[x] / 16;
    const std::int32_t cut = block > kMost ? kMost : block < -kMost ? -kMost : block;
    out[x] = cut * cut;
  }
}

HOLDFAST_INLINE void moves(const float* start_px, const float* fitted_px, int width,
                           std::int32_t* out) {
#pragma GCC ivdep
  for (int x = 0; x < width; ++x) {
    const float step = 256 * (fitted_px[x] - start_px[x]);
    out[x] = static_cast<std::int32_t>(step == step ? step * step : -1.F);
  }
}

HOLDFAST_INLINE void variances(const Scatter& scatter, const Sensitivity& sensitivity,
                               float freedom, int width, float* variance_px2) {
  constexpr int kBlockPx = 2 * kBlockRadiusPx + 1;
  const float unit = kSquareUnit / (static_cast<float>(kBlockPx * kBlockPx) * freedom);
#pragma GCC ivdep
  for (int x = 0; x < width; ++x) {
    const float share = 1 / static_cast<float>(scatter.count[x] > 1 ? scatter.count[x] : 1);
    // At least what rounding to 1/8 grey level leaves.
    const float of_score = unit * static_cast<float>(scatter.squares[x] + 1) /
                           static_cast<float>(scatter.energy[x] > 1 ? scatter.energy[x] : 1);
    // A window's start is corrected as a whole: how corrections differ from place to place is how
    // wrong its shape was, and stays in the result.
    const float of_shape = static_cast<float>(scatter.moved[x]) * share * (1.F / 65536);
    variance_px2[x] = sensitivity.per_score[x] * of_score + of_shape + sensitivity.of_start_px2[x];
  }
}

HOLDFAST_INLINE void offsets(const std::int32_t* offset_256ths, int width, int sign,
                             std::int32_t* sum, std::int32_t* count) {
#pragma GCC ivdep
  for (int x = 0; x < width; ++x) {
    const std::int32_t is_known = offset_256ths[x] >= 0 ? sign : 0;
    sum[x] += is_known * offset_256ths[x];
    count[x] += is_known;
  }
}

HOLDFAST_INLINE void smooth(const std::int32_t* offset_256ths, const std::int32_t* sum,
                            const std::int32_t* count, int width, int least, float near_px,
                            float* out_px) {
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  const float reach = 256 * near_px;
#pragma GCC ivdep
  for (int x = 0; x < width; ++x) {
    const float n = static_cast<float>(count[x]), own = static_cast<float>(offset_256ths[x]);
    const float mean = static_cast<float>(sum[x]) / (n > 1 ? n : 1);
    const float away = own - mean;
    const float value = away <= reach && away >= -reach ? mean : own;
    out_px[x] = offset_256ths[x] >= 0 && count[x] >= least ? value * (1.F / 256) : kNan;
  }
}

HOLDFAST_INLINE void quantise(const float* offset_px, int width, std::int32_t* out_256ths) {
#pragma GCC ivdep
  for (int x = 0; x < width; ++x) {
    const float scaled = offset_px[x] * 256 + 0.5F;
    out_256ths[x] = static_cast<std::int32_t>(scaled >= 0 ? scaled : -1.F);
  }
}

#define HOLDFAST_BOTH(name, body, parameters, arguments) \
  void name##_scalar parameters {                        \
    body arguments;                                      \
  }                                                      \
  HOLDFAST_AVX2 void name##_avx2 parameters {            \
    body arguments;                                      \
  }

HOLDFAST_BOTH(add_products, products, (const Residuals& row, int width, int sign, const Sums& sums),
              (row, width, sign, sums))
HOLDFAST_BOTH(add_offsets, offsets,
              (const std::int32_t* offset_256ths, int width, int sign, std::int32_t* sum,
               std::int32_t* count),
              (offset_256ths, width, sign, sum, count))
HOLDFAST_BOTH(smooth_row, smooth,
              (const std::int32_t* offset_256ths, const std::int32_t* sum,
               const std::int32_t* count, int width, int least, float near_px, float* out_px),
              (offset_256ths, sum, count, width, least, near_px, out_px))
HOLDFAST_BOTH(quantise_row, quantise, (const float* offset_px, int width, std::int32_t* out_256ths),
              (offset_px, width, out_256ths))
HOLDFAST_BOTH(window_sum, windows,
              (const std::int32_t* in, int width, int radius, std::int32_t* scratch,
               std::int32_t* out),
              (in, width, radius, scratch, out))
HOLDFAST_BOTH(add_moments, moments_row, (const Sums& sums, int width, const Moments& moments),
              (sums, width, moments))
HOLDFAST_BOTH(solve_row, solve,
              (const Moments& moments, int width, const Limits& limits, float* offset_px,
               const Sensitivity& out),
              (moments, width, limits, offset_px, out))
HOLDFAST_BOTH(add_scores, scores_row,
              (const Residuals& row, const Sums& window, const float* start_px,
               const float* fitted_px, int width, const Scores& scores),
              (row, window, start_px, fitted_px, width, scores))
HOLDFAST_BOTH(square_row, squares, (const std::int32_t* blocks, int width, std::int32_t* out),
              (blocks, width, out))
HOLDFAST_BOTH(moved_row, moves,
              (const float* start_px, const float* fitted_px, int width, std::int32_t* out),
              (start_px, fitted_px, width, out))
HOLDFAST_BOTH(variance_row, variances,
              (const Scatter& scatter, const Sensitivity& sensitivity, float freedom, int width,
               float* variance_px2),
              (scatter, sensitivity, freedom, width, variance_px2))

}  // namespace

void residual_row(const Images& images, const float* offset_px, const Residuals& out, Simd simd) {
  if (simd == Simd::avx2) return residual_row_avx2(images, offset_px, out);
  for (int x = 0; x < images.width; ++x) residual_pixel(images, x, offset_px[x], out);
}

void add_products(const Residuals& row, int width, int sign, const Sums& sums, Simd simd) {
  (simd == Simd::avx2 ? add_products_avx2 : add_products_scalar)(row, width, sign, sums);
}

void window_sum(const std::int32_t* in, int width, int radius, std::int32_t* scratch,
                std::int32_t* out, Simd simd) {
  (simd == Simd::avx2 ? window_sum_avx2 : window_sum_scalar)(in, width, radius, scratch, out);
}

void add_moments(const Sums& sums, int width, const Moments& moments, Simd simd) {
  (simd == Simd::avx2 ? add_moments_avx2 : add_moments_scalar)(sums, width, moments);
}

void solve_row(const Moments& moments, int width, const Limits& limits, float* offset_px,
               const Sensitivity& out, Simd simd) {
  (simd == Simd::avx2 ? solve_row_avx2 : solve_row_scalar)(moments, width, limits, offset_px, out);
}

void add_scores(const Residuals& row, const Sums& window, const float* start_px,
                const float* fitted_px, int width, const Scores& scores, Simd simd) {
  (simd == Simd::avx2 ? add_scores_avx2 : add_scores_scalar)(row, window, start_px, fitted_px,
                                                             width, scores);
}

void square_row(const std::int32_t* blocks, int width, std::int32_t* out, Simd simd) {
  (simd == Simd::avx2 ? square_row_avx2 : square_row_scalar)(blocks, width, out);
}

void moved_row(const float* start_px, const float* fitted_px, int width, std::int32_t* out,
               Simd simd) {
  (simd == Simd::avx2 ? moved_row_avx2 : moved_row_scalar)(start_px, fitted_px, width, out);
}

void variance_row(const Scatter& scatter, const Sensitivity& sensitivity, float freedom, int width,
                  float* variance_px2, Simd simd) {
  (simd == Simd::avx2 ? variance_row_avx2 : variance_row_scalar)(scatter, sensitivity, freedom,
                                                                 width, variance_px2);
}

void add_offsets(const std::int32_t* offset_256ths, int width, int sign, std::int32_t* sum,
                 std::int32_t* count, Simd simd) {
  (simd == Simd::avx2 ? add_offsets_avx2 : add_offsets_scalar)(offset_256ths, width, sign, sum,
                                                               count);
}

void smooth_row(const std::int32_t* offset_256ths, const std::int32_t* sum,
                const std::int32_t* count, int width, int least, float near_px, float* out_px,
                Simd simd) {
  (simd == Simd::avx2 ? smooth_row_avx2 : smooth_row_scalar)(offset_256ths, sum, count, width,
                                                             least, near_px, out_px);
}

void quantise_row(const float* offset_px, int width, std::int32_t* out_256ths, Simd simd) {
  (simd == Simd::avx2 ? quantise_row_avx2 : quantise_row_scalar)(offset_px, width, out_256ths);
}

}  // namespace holdfast::registration::refinement
