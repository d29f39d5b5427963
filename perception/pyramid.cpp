// SPDX-License-Identifier: Apache-2.0
#include "perception/pyramid.hpp"

#include <cstddef>

#include <immintrin.h>

#define HOLDFAST_AVX2 __attribute__((target("avx2,fma")))

namespace holdfast::perception {
namespace {

// OpenCV's luma, 0.299 R + 0.587 G + 0.114 B, in 1/128; as in the reflection mask.
constexpr int kBlue = 15, kGreen = 75, kRed = 38, kRounding = 64, kShift = 7;

uchar luma(const uchar* bgr) {
  return static_cast<uchar>((kBlue * bgr[0] + kGreen * bgr[1] + kRed * bgr[2] + kRounding) >>
                            kShift);
}

uchar mean_of_four(const uchar* top, const uchar* bottom) {
  return static_cast<uchar>((top[0] + top[1] + bottom[0] + bottom[1] + 2) >> 2);
}

/// Pixels [from, width) of a row.
void grey_row_scalar(const uchar* bgr, int from, int width, uchar* grey) {
  for (int x = from; x < width; ++x) grey[x] = luma(bgr + static_cast<std::ptrdiff_t>(3) * x);
}

/// Pixels [from, width) of a row of half the width.
void halve_row_scalar(const uchar* top, const uchar* bottom, int from, int width, uchar* out) {
  for (int x = from; x < width; ++x)
    out[x] = mean_of_four(top + static_cast<std::ptrdiff_t>(2) * x,
                          bottom + static_cast<std::ptrdiff_t>(2) * x);
}

/// Four pixels a lane, from 12 bytes each: luma in 32 bit.
HOLDFAST_AVX2 inline __m256i luma_of_eight(const uchar* bgr) {
  const __m256i spread = _mm256_setr_epi8(0, 1, 2, -1, 3, 4, 5, -1, 6, 7, 8, -1, 9, 10, 11, -1, 0,
                                          1, 2, -1, 3, 4, 5, -1, 6, 7, 8, -1, 9, 10, 11, -1);
  const __m256i weights = _mm256_set1_epi32(kBlue | kGreen << 8 | kRed << 16);
  const __m256i bytes = _mm256_inserti128_si256(
      _mm256_castsi128_si256(_mm_loadu_si128(reinterpret_cast<const __m128i*>(bgr))),
      _mm_loadu_si128(reinterpret_cast<const __m128i*>(bgr + 12)), 1);
  const __m256i pairs = _mm256_maddubs_epi16(_mm256_shuffle_epi8(bytes, spread), weights);
  const __m256i sums = _mm256_madd_epi16(pairs, _mm256_set1_epi16(1));
  return _mm256_srli_epi32(_mm256_add_epi32(sums, _mm256_set1_epi32(kRounding)), kShift);
}

HOLDFAST_AVX2 void grey_row_avx2(const uchar* bgr, int width, uchar* grey) {
  constexpr int kStep = 32;
  // The packs leave groups of four in the order 0 2 4 6 1 3 5 7.
  const __m256i order = _mm256_setr_epi32(0, 4, 1, 5, 2, 6, 3, 7);
  int x = 0;
  // A load reads 4 bytes beyond the pixels it is for: the last ones are left to the scalar loop.
  for (; x + kStep + 2 <= width; x += kStep) {
    const uchar* p = bgr + static_cast<std::ptrdiff_t>(3) * x;
    const __m256i low = _mm256_packus_epi32(luma_of_eight(p), luma_of_eight(p + 24));
    const __m256i high = _mm256_packus_epi32(luma_of_eight(p + 48), luma_of_eight(p + 72));
    const __m256i all = _mm256_permutevar8x32_epi32(_mm256_packus_epi16(low, high), order);
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(grey + x), all);
  }
  grey_row_scalar(bgr, x, width, grey);
}

HOLDFAST_AVX2 inline __m256i sums_of_four(const uchar* top, const uchar* bottom) {
  const __m256i ones = _mm256_set1_epi8(1);
  const __m256i a = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(top));
  const __m256i b = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(bottom));
  const __m256i sum =
      _mm256_add_epi16(_mm256_maddubs_epi16(a, ones), _mm256_maddubs_epi16(b, ones));
  return _mm256_srli_epi16(_mm256_add_epi16(sum, _mm256_set1_epi16(2)), 2);
}

HOLDFAST_AVX2 void halve_row_avx2(const uchar* top, const uchar* bottom, int width, uchar* out) {
  constexpr int kStep = 32;
  int x = 0;
  for (; x + kStep <= width; x += kStep) {
    const std::ptrdiff_t i = static_cast<std::ptrdiff_t>(2) * x;
    const __m256i low = sums_of_four(top + i, bottom + i);
    const __m256i high = sums_of_four(top + i + 32, bottom + i + 32);
    const __m256i all = _mm256_permute4x64_epi64(_mm256_packus_epi16(low, high), 0b11011000);
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(out + x), all);
  }
  halve_row_scalar(top, bottom, x, width, out);
}

void grey_row(const uchar* bgr, int width, uchar* grey, Simd simd) {
  if (simd == Simd::avx2)
    grey_row_avx2(bgr, width, grey);
  else
    grey_row_scalar(bgr, 0, width, grey);
}

void halve_row(const cv::Mat& from, int row, cv::Mat& to, Simd simd) {
  const uchar *top = from.ptr(2 * row), *bottom = from.ptr(2 * row + 1);
  if (simd == Simd::avx2)
    halve_row_avx2(top, bottom, to.cols, to.ptr(row));
  else
    halve_row_scalar(top, bottom, 0, to.cols, to.ptr(row));
}

}  // namespace

void make_pyramid(const cv::Mat& image, Pyramid& out, Simd simd) {
  auto& [grey, half, quarter] = out.levels;
  const bool is_colour = image.channels() == 3;
  if (is_colour) {
    out.grey_memory.create(image.size(), CV_8UC1);
    grey = out.grey_memory;
  } else {
    grey = image;
  }
  half.create(image.rows / 2, image.cols / 2, CV_8UC1);
  quarter.create(half.rows / 2, half.cols / 2, CV_8UC1);
  for (int y = 0; y < image.rows; ++y) {
    if (is_colour) grey_row(image.ptr(y), image.cols, grey.ptr(y), simd);
    if (y % 2 == 1) halve_row(grey, y / 2, half, simd);
    if (y % 4 == 3) halve_row(half, y / 4, quarter, simd);
  }
}

}  // namespace holdfast::perception
