// SPDX-License-Identifier: Apache-2.0
#include "registration/disparity_upsampling.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

// Plain loops that the compiler turns into vectors, once for each instruction set.
#define HOLDFAST_INLINE inline __attribute__((always_inline))
#define HOLDFAST_AVX2 __attribute__((target("avx2")))

namespace holdfast::registration {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kEdgePx = 1;  // of a level: neighbours further apart lie on two surfaces
constexpr int kRowsPerTask = 32;

int tasks_of(int rows) {
  return (rows + kRowsPerTask - 1) / kRowsPerTask;
}

HOLDFAST_INLINE float mixed(float own, float other, float share) {
  const float step = other - own;
  return own + (step < kEdgePx && step > -kEdgePx ? share * step : 0.F);
}

/// A row of the level between two of its rows, NaN at both ends beyond it.
struct LevelRow {
  const float *offset, *variance, *clear;  // offset[-1] and offset[width] are there
  int width;
};
/// The same row of the full grid.
struct FullRow {
  float *disparity, *variance, *confidence;
};

/// Every 2^level-th pixel from the `i`-th on.
HOLDFAST_INLINE void phase(const LevelRow& row, const UpsamplingParameters& parameters, int i,
                           const FullRow& out) {
  const int size = 1 << parameters.level;
  const auto scale = static_cast<float>(size);
  const float across = (static_cast<float>(i) + 0.5F) / scale - 0.5F, share = std::abs(across);
  const float* const other = row.offset + (across < 0 ? -1 : 1);
#pragma GCC ivdep
  for (int x = 0; x < row.width; ++x) {
    const float offset = mixed(row.offset[x], other[x], share);
    const bool is_known = offset == offset;
    out.disparity[size * x + i] = parameters.largest_px - scale * offset;
    out.variance[size * x + i] = is_known ? scale * scale * row.variance[x] : kNan;
    out.confidence[size * x + i] = is_known ? row.clear[x] : 0.F;
  }
}

/// Both pixels of level 1 at once: the compiler writes whole vectors.
HOLDFAST_INLINE void pairs(const LevelRow& row, const UpsamplingParameters& parameters,
                           const FullRow& out) {
  const float *const before = row.offset - 1, *const after = row.offset + 1;
#pragma GCC ivdep
  for (int x = 0; x < row.width; ++x) {
    const float own = row.offset[x];
    const float variance = own == own ? 4 * row.variance[x] : kNan;
    const float confidence = own == own ? row.clear[x] : 0.F;
    out.disparity[2 * x] = parameters.largest_px - 2 * mixed(own, before[x], 0.25F);
    out.disparity[2 * x + 1] = parameters.largest_px - 2 * mixed(own, after[x], 0.25F);
    out.variance[2 * x] = variance;
    out.variance[2 * x + 1] = variance;
    out.confidence[2 * x] = confidence;
    out.confidence[2 * x + 1] = confidence;
  }
}

HOLDFAST_INLINE void full_row(const LevelRow& row, const UpsamplingParameters& parameters,
                              const FullRow& out) {
  if (parameters.level == 1) return pairs(row, parameters, out);
  for (int i = 0; i < 1 << parameters.level; ++i) phase(row, parameters, i, out);
}

void full_row_scalar(const LevelRow& row, const UpsamplingParameters& parameters,
                     const FullRow& out) {
  full_row(row, parameters, out);
}
HOLDFAST_AVX2 void full_row_avx2(const LevelRow& row, const UpsamplingParameters& parameters,
                                 const FullRow& out) {
  full_row(row, parameters, out);
}

HOLDFAST_INLINE std::int32_t quantised(float offset_px) {
  const float scaled = 256 * offset_px + 0.5F;
  return static_cast<std::int32_t>(scaled >= 0 ? scaled : -1.F);  // NaN is not
}
static_assert(kNoOffset == -1);

/// The rows of one task.
class Rows {
 public:
  Rows(const LevelOffsets& from, const UpsamplingParameters& parameters, Simd simd)
      : from_(from),
        parameters_(parameters),
        simd_(simd),
        offset_(static_cast<std::size_t>(width()) + 2, kNan),
        clear_(static_cast<std::size_t>(width())) {}

  void write(int y, const FullMaps& out) {
    const cv::Mat1f& offsets = from_.refined.offset_px;
    const int size = 1 << parameters_.level, at = y >> parameters_.level;
    // Where this row lies between those of the level: share of the further one.
    const float place = (static_cast<float>(y % size) + 0.5F) / static_cast<float>(size) - 0.5F;
    const int beside = std::clamp(at + (place < 0 ? -1 : 1), 0, offsets.rows - 1);
    const float* const variance = from_.refined.variance_px2[at];
    between(offsets[at], variance, offsets[beside], std::abs(place));
    confidence(from_.margin[at >> from_.margin_halvings]);
    (simd_ == Simd::avx2 ? full_row_avx2 : full_row_scalar)(
        {offset_.data() + 1, variance, clear_.data(), width()}, parameters_,
        {out.disparity_px[y], out.variance_px2[y], out.confidence[y]});
  }

 private:
  [[nodiscard]] int width() const { return from_.refined.offset_px.cols; }
  void between(const float* own, const float* variance, const float* other, float share) {
    float* const to = offset_.data() + 1;
    for (int x = 0; x < width(); ++x)
      to[x] = variance[x] <= parameters_.variance_max ? mixed(own[x], other[x], share) : kNan;
  }
  void confidence(const uchar* margin) {
    const float scale = 1 / parameters_.clear_margin;
    for (int x = 0; x < width(); ++x)
      clear_[static_cast<std::size_t>(x)] =
          std::min(static_cast<float>(margin[x >> from_.margin_halvings]) * scale, 1.F);
  }

  const LevelOffsets& from_;
  const UpsamplingParameters& parameters_;
  Simd simd_;
  std::vector<float> offset_;  // one more at either end
  std::vector<float> clear_;
};

}  // namespace

void doubled(const cv::Mat1f& offset_px, WorkerPool& pool, cv::Mat1i& fine_256ths) {
  const int width = offset_px.cols, height = offset_px.rows;
  fine_256ths.create(2 * height, 2 * width);
  pool.run(tasks_of(height), [&](int task) {
    std::vector<float> between(static_cast<std::size_t>(width) + 2, kNan);
    float* const middle = between.data() + 1;
    const int end = std::min((task + 1) * kRowsPerTask, height);
    for (int y = 2 * task * kRowsPerTask; y < 2 * end; ++y) {
      const float* const own = offset_px[y / 2];
      const float* const beside =
          offset_px[std::clamp(y / 2 + (y % 2 == 0 ? -1 : 1), 0, height - 1)];
      for (int x = 0; x < width; ++x) middle[x] = mixed(own[x], beside[x], 0.25F);
      std::int32_t* const to = fine_256ths[y];
      for (int x = 0; x < width; ++x) {
        to[2 * x] = quantised(2 * mixed(middle[x], middle[x - 1], 0.25F));
        to[2 * x + 1] = quantised(2 * mixed(middle[x], middle[x + 1], 0.25F));
      }
    }
  });
}

void upsample(const LevelOffsets& from, const UpsamplingParameters& parameters, WorkerPool& pool,
              const FullMaps& out, Simd simd) {
  const int height = out.disparity_px.rows;
  pool.run(tasks_of(height), [&](int task) {
    Rows rows(from, parameters, simd);
    const int end = std::min((task + 1) * kRowsPerTask, height);
    for (int y = task * kRowsPerTask; y < end; ++y) rows.write(y, out);
  });
}

}  // namespace holdfast::registration
