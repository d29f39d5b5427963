// SPDX-License-Identifier: Apache-2.0
#include "perception/patch_kernel.hpp"

#include <array>
#include <cmath>

#include <immintrin.h>

#define HOLDFAST_AVX2 __attribute__((target("avx2,fma")))
#define HOLDFAST_AVX2_INLINE inline __attribute__((target("avx2,fma"), always_inline))

namespace holdfast::perception {
namespace {

constexpr float kHalfSide = 0.5F * (kPatchSide - 1);

/// The place with its integer part taken out: what is left is exact in single precision.
struct Origin {
  const uchar* pixel;
  float u, v;
};

Origin origin_of(const cv::Mat& image, const PatchPlace& place) noexcept {
  const double u = std::floor(place.u_px), v = std::floor(place.v_px);
  return {image.ptr(static_cast<int>(v)) + static_cast<int>(u), static_cast<float>(place.u_px - u),
          static_cast<float>(place.v_px - v)};
}

std::array<float, 4> catmull_rom(float f) noexcept {
  return {f * (-0.5F + f * (1 - 0.5F * f)), 1 + f * f * (1.5F * f - 2.5F),
          f * (0.5F + f * (2 - 1.5F * f)), f * f * (0.5F * f - 0.5F)};
}

float sample(const uchar* p, std::ptrdiff_t step, float fu, float fv, bool is_cubic) noexcept {
  const std::array<float, 4> wu =
      is_cubic ? catmull_rom(fu) : std::array<float, 4>{0, 1 - fu, fu, 0};
  const std::array<float, 4> wv =
      is_cubic ? catmull_rom(fv) : std::array<float, 4>{0, 1 - fv, fv, 0};
  float sum = 0;
  for (std::ptrdiff_t j = 0; j < 4; ++j) {
    const uchar* row = p + (j - 1) * step - 1;
    float along = 0;
    for (std::size_t i = 0; i < 4; ++i) along += wu[i] * static_cast<float>(row[i]);
    sum += wv[static_cast<std::size_t>(j)] * along;
  }
  return sum;
}

PatchSums sums_scalar(const cv::Mat& image, const PatchPlace& place, const PatchPixels& pixels,
                      bool is_cubic) noexcept {
  const Origin origin = origin_of(image, place);
  const auto step = static_cast<std::ptrdiff_t>(image.step1());
  PatchSums sums;
  std::size_t k = 0;
  for (int j = 0; j < kPatchSide; ++j)
    for (int i = 0; i < kPatchSide; ++i, ++k) {
      const float x = static_cast<float>(i) - kHalfSide, y = static_cast<float>(j) - kHalfSide;
      const float u = origin.u + place.a00 * x + place.a01 * y;
      const float v = origin.v + place.a10 * x + place.a11 * y;
      const float iu = std::floor(u), iv = std::floor(v);
      const uchar* p =
          origin.pixel + static_cast<std::ptrdiff_t>(iv) * step + static_cast<std::ptrdiff_t>(iu);
      const float value = sample(p, step, u - iu, v - iv, is_cubic);
      sums.i += value;
      sums.ii += value * value;
      sums.vi += value * pixels.value[k];
      sums.gxi += value * pixels.gx[k];
      sums.gyi += value * pixels.gy[k];
    }
  return sums;
}

HOLDFAST_AVX2_INLINE float sum_of(__m256 v) {
  const __m128 four = _mm_add_ps(_mm256_castps256_ps128(v), _mm256_extractf128_ps(v, 1));
  const __m128 two = _mm_add_ps(four, _mm_movehl_ps(four, four));
  return _mm_cvtss_f32(_mm_add_ss(two, _mm_movehdup_ps(two)));
}

/// Byte `kByte` of each 32-bit lane as a float.
template <int kByte>
HOLDFAST_AVX2_INLINE __m256 byte_of(__m256i lanes) {
  const __m256i shifted = kByte == 0 ? lanes : _mm256_srli_epi32(lanes, 8 * kByte);
  return _mm256_cvtepi32_ps(kByte == 3 ? shifted
                                       : _mm256_and_si256(shifted, _mm256_set1_epi32(0xff)));
}

HOLDFAST_AVX2_INLINE __m256i gather(const uchar* p, __m256i index) {
  // Reads 4 bytes from each address: is_inside() keeps the margin.
  return _mm256_i32gather_epi32(reinterpret_cast<const int*>(p), index, 1);
}

struct Weights {
  __m256 w0, w1, w2, w3;
};

HOLDFAST_AVX2_INLINE Weights catmull_rom_avx2(__m256 f) {
  const __m256 half = _mm256_set1_ps(0.5F), one = _mm256_set1_ps(1);
  const __m256 f2 = _mm256_mul_ps(f, f);
  Weights w;
  w.w0 = _mm256_mul_ps(f, _mm256_fmsub_ps(f, _mm256_fnmadd_ps(half, f, one), half));
  w.w1 = _mm256_fmadd_ps(f2, _mm256_fmsub_ps(_mm256_set1_ps(1.5F), f, _mm256_set1_ps(2.5F)), one);
  w.w2 = _mm256_mul_ps(
      f, _mm256_fmadd_ps(f, _mm256_fnmadd_ps(_mm256_set1_ps(1.5F), f, _mm256_set1_ps(2)), half));
  w.w3 = _mm256_mul_ps(f2, _mm256_fmsub_ps(half, f, half));
  return w;
}

HOLDFAST_AVX2_INLINE __m256 cubic_along(__m256i bytes, const Weights& w) {
  __m256 sum = _mm256_mul_ps(w.w0, byte_of<0>(bytes));
  sum = _mm256_fmadd_ps(w.w1, byte_of<1>(bytes), sum);
  sum = _mm256_fmadd_ps(w.w2, byte_of<2>(bytes), sum);
  return _mm256_fmadd_ps(w.w3, byte_of<3>(bytes), sum);
}

template <bool kIsCubic>
HOLDFAST_AVX2 PatchSums sums_avx2(const cv::Mat& image, const PatchPlace& place,
                                  const PatchPixels& pixels) {
  const Origin origin = origin_of(image, place);
  const auto step = static_cast<int>(image.step1());
  const __m256i steps = _mm256_set1_epi32(step);
  const __m256 x = _mm256_setr_ps(-3.5F, -2.5F, -1.5F, -0.5F, 0.5F, 1.5F, 2.5F, 3.5F);
  const __m256 u_of_x = _mm256_fmadd_ps(_mm256_set1_ps(place.a00), x, _mm256_set1_ps(origin.u));
  const __m256 v_of_x = _mm256_fmadd_ps(_mm256_set1_ps(place.a10), x, _mm256_set1_ps(origin.v));
  __m256 i = _mm256_setzero_ps(), ii = i, vi = i, gxi = i, gyi = i;
  for (int j = 0; j < kPatchSide; ++j) {
    const float y = static_cast<float>(j) - kHalfSide;
    const __m256 u = _mm256_add_ps(u_of_x, _mm256_set1_ps(place.a01 * y));
    const __m256 v = _mm256_add_ps(v_of_x, _mm256_set1_ps(place.a11 * y));
    const __m256 iu = _mm256_floor_ps(u), iv = _mm256_floor_ps(v);
    const __m256 fu = _mm256_sub_ps(u, iu), fv = _mm256_sub_ps(v, iv);
    const __m256i index =
        _mm256_add_epi32(_mm256_mullo_epi32(_mm256_cvtps_epi32(iv), steps), _mm256_cvtps_epi32(iu));
    __m256 value;
    if constexpr (kIsCubic) {
      const Weights wu = catmull_rom_avx2(fu), wv = catmull_rom_avx2(fv);
      const uchar* p = origin.pixel - step - 1;
      value = _mm256_mul_ps(wv.w0, cubic_along(gather(p, index), wu));
      value = _mm256_fmadd_ps(wv.w1, cubic_along(gather(p + step, index), wu), value);
      value = _mm256_fmadd_ps(wv.w2, cubic_along(gather(p + 2 * step, index), wu), value);
      value = _mm256_fmadd_ps(wv.w3, cubic_along(gather(p + 3 * step, index), wu), value);
    } else {
      const __m256i top = gather(origin.pixel, index), bottom = gather(origin.pixel + step, index);
      const __m256 t0 = byte_of<0>(top), b0 = byte_of<0>(bottom);
      const __m256 t = _mm256_fmadd_ps(fu, _mm256_sub_ps(byte_of<1>(top), t0), t0);
      const __m256 b = _mm256_fmadd_ps(fu, _mm256_sub_ps(byte_of<1>(bottom), b0), b0);
      value = _mm256_fmadd_ps(fv, _mm256_sub_ps(b, t), t);
    }
    const int k = j * kPatchSide;
    i = _mm256_add_ps(i, value);
    ii = _mm256_fmadd_ps(value, value, ii);
    vi = _mm256_fmadd_ps(value, _mm256_load_ps(pixels.value + k), vi);
    gxi = _mm256_fmadd_ps(value, _mm256_load_ps(pixels.gx + k), gxi);
    gyi = _mm256_fmadd_ps(value, _mm256_load_ps(pixels.gy + k), gyi);
  }
  return {sum_of(i), sum_of(ii), sum_of(vi), sum_of(gxi), sum_of(gyi)};
}

}  // namespace

bool is_inside(const PatchPlace& place, int width_px, int height_px) noexcept {
  const double reach_x =
      static_cast<double>(kHalfSide * (std::abs(place.a00) + std::abs(place.a01)));
  const double reach_y =
      static_cast<double>(kHalfSide * (std::abs(place.a10) + std::abs(place.a11)));
  // One pixel before, and three after: the gathers read four bytes. NaN is outside.
  return place.u_px - reach_x >= 2 && place.v_px - reach_y >= 2 &&
         place.u_px + reach_x <= width_px - 5 && place.v_px + reach_y <= height_px - 5;
}

PatchSums patch_sums(const cv::Mat& image, const PatchPlace& place, const PatchPixels& pixels,
                     Interpolation interpolation, Simd simd) noexcept {
  const bool is_cubic = interpolation == Interpolation::bicubic;
  if (simd == Simd::scalar) return sums_scalar(image, place, pixels, is_cubic);
  return is_cubic ? sums_avx2<true>(image, place, pixels) : sums_avx2<false>(image, place, pixels);
}

}  // namespace holdfast::perception
