// SPDX-License-Identifier: Apache-2.0
#include "registration/census.hpp"

#include <algorithm>
#include <array>
#include <cstdlib>
#include <vector>

namespace holdfast::registration {
namespace {

constexpr int kBits = 31, kRowsPerTask = 32, kReachY = 3;

struct Offset {
  int x, y;
};

/// One half of the window, the nearest pixels first: bursts use the first few only.
constexpr std::array<Offset, kBits> kOffsets = {
    {{1, 0},  {0, 1},  {1, 1},  {-1, 1}, {2, 0},  {0, 2},  {2, 1}, {-2, 1},
     {1, 2},  {-1, 2}, {2, 2},  {-2, 2}, {3, 0},  {0, 3},  {3, 1}, {-3, 1},
     {1, 3},  {-1, 3}, {3, 2},  {-3, 2}, {2, 3},  {-2, 3}, {4, 0}, {3, 3},
     {-3, 3}, {4, 1},  {-4, 1}, {4, 2},  {-4, 2}, {4, 3},  {-4, 3}}};

/// Where one bit of the word comes from.
struct Comparison {
  const uchar *one, *other;  // at column 0 of the row
};

// The kernels below are plain loops that the compiler turns into vectors, once for each
// instruction set: integers only, so that both give the same bits.
#define HOLDFAST_INLINE inline __attribute__((always_inline))

HOLDFAST_INLINE void census_row(const Comparison* bits, int start, int end,
                                std::uint8_t* const* planes, std::int32_t* out) {
  for (int plane = 0; plane < 4; ++plane) {
    std::uint8_t* const bytes = planes[plane];
    std::fill(bytes + start, bytes + end, std::uint8_t{0});
    for (int k = 8 * plane; k < std::min(8 * plane + 8, kBits); ++k) {
      const uchar *const one = bits[k].one, *const other = bits[k].other;
      const auto bit = static_cast<std::uint8_t>(1U << (k % 8));
      for (int x = start; x < end; ++x)
        bytes[x] = static_cast<std::uint8_t>(bytes[x] | (one[x] > other[x] ? bit : 0));
    }
  }
  const std::uint8_t *a = planes[0], *b = planes[1], *c = planes[2], *d = planes[3];
  for (int x = start; x < end; ++x) out[x] = a[x] | b[x] << 8 | c[x] << 16 | d[x] << 24;
}

HOLDFAST_INLINE void halve_row(const uchar* above, const uchar* below, int width, uchar* out) {
  for (int x = 0; x < width; ++x)
    out[x] = static_cast<uchar>(
        (above[2 * x] + above[2 * x + 1] + below[2 * x] + below[2 * x + 1] + 2) >> 2);
}

void census_row_scalar(const Comparison* bits, int start, int end, std::uint8_t* const* planes,
                       std::int32_t* out) {
  census_row(bits, start, end, planes, out);
}
__attribute__((target("avx2"))) void census_row_avx2(const Comparison* bits, int start, int end,
                                                     std::uint8_t* const* planes,
                                                     std::int32_t* out) {
  census_row(bits, start, end, planes, out);
}
void halve_row_scalar(const uchar* above, const uchar* below, int width, uchar* out) {
  halve_row(above, below, width, out);
}
__attribute__((target("avx2"))) void halve_row_avx2(const uchar* above, const uchar* below,
                                                    int width, uchar* out) {
  halve_row(above, below, width, out);
}

/// Bit k comes from shot k mod N, its nearest comparisons first.
std::array<Comparison, kBits> comparisons(std::span<const cv::Mat1b> shots,
                                          std::span<const cv::Mat1b> lowered, int y) {
  std::array<Comparison, kBits> bits{};
  for (std::size_t k = 0; k < bits.size(); ++k) {
    const std::size_t shot = k % shots.size();
    const Offset offset = kOffsets[k / shots.size()];
    bits[k] = {lowered[shot][y + offset.y] + offset.x, shots[shot][y - offset.y] - offset.x};
  }
  return bits;
}

}  // namespace

void census(std::span<const cv::Mat1b> shots, std::uint8_t threshold, WorkerPool& pool,
            cv::Mat1i& out, Simd simd) {
  const int width = shots[0].cols, height = shots[0].rows;
  out.create(height, width);
  std::vector<cv::Mat1b> lowered(shots.size());  // by the threshold, at least to 0
  for (std::size_t i = 0; i < shots.size(); ++i) cv::subtract(shots[i], threshold, lowered[i]);
  const auto rows = [&](int task) {
    std::array<std::vector<std::uint8_t>, 4> bytes;
    std::array<std::uint8_t*, 4> planes{};
    for (std::size_t i = 0; i < 4; ++i) {
      bytes[i].resize(static_cast<std::size_t>(width));
      planes[i] = bytes[i].data();
    }
    const int end = std::min((task + 1) * kRowsPerTask, height);
    for (int y = task * kRowsPerTask; y < end; ++y) {
      const auto bits = comparisons(shots, lowered, std::clamp(y, kReachY, height - 1 - kReachY));
      std::int32_t* const row = out[y];
      (simd == Simd::avx2 ? census_row_avx2 : census_row_scalar)(
          bits.data(), kCensusMarginPx, width - kCensusMarginPx, planes.data(), row);
      std::fill_n(row, kCensusMarginPx, row[kCensusMarginPx]);
      std::fill_n(row + width - kCensusMarginPx, kCensusMarginPx, row[width - kCensusMarginPx - 1]);
    }
  };
  pool.run((height + kRowsPerTask - 1) / kRowsPerTask, rows);
}

double noise_of(const cv::Mat1b& image) {
  constexpr int kStepX = 5, kStepY = 7;
  std::array<int, 1021> histogram{};
  int count = 0;
  for (int y = 0; y < image.rows; y += kStepY)
    for (int x = 1; x + 1 < image.cols; x += kStepX, ++count)
      ++histogram[static_cast<std::size_t>(
          std::abs(image(y, x - 1) - 2 * image(y, x) + image(y, x + 1)))];
  // The 30th percentile of |N(0, 6 sigma²)| is 0.385·2.449 sigma; between whole levels linearly.
  const double wanted = 0.3 * count;
  double below = 0;
  for (std::size_t level = 0; level < histogram.size(); ++level) {
    const double here = histogram[level];
    if (below + here >= wanted && here > 0) {
      const double value = static_cast<double>(level) - 0.5 + (wanted - below) / here;
      return std::max(value, 0.0) / (0.385 * 2.449);
    }
    below += here;
  }
  return 0;
}

void halve(const cv::Mat1b& image, WorkerPool& pool, cv::Mat1b& out, Simd simd) {
  out.create(image.rows / 2, image.cols / 2);
  const auto rows = [&](int task) {
    const int end = std::min((task + 1) * kRowsPerTask, out.rows);
    for (int y = task * kRowsPerTask; y < end; ++y)
      (simd == Simd::avx2 ? halve_row_avx2 : halve_row_scalar)(image[2 * y], image[2 * y + 1],
                                                               out.cols, out[y]);
  };
  pool.run((out.rows + kRowsPerTask - 1) / kRowsPerTask, rows);
}

}  // namespace holdfast::registration
