// SPDX-License-Identifier: Apache-2.0
#include "registration/disparity_refinement.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <vector>

#include "registration/census.hpp"
#include "registration/refinement_rows.hpp"

namespace holdfast::registration {
namespace {

using namespace refinement;  // NOLINT(google-build-using-namespace): the loops of this very file

constexpr int kBandRows = 96;
constexpr float kNearPx = 0.75F;  // of a fitted offset to its neighbours' mean; further: an edge

int bands_of(int height) {
  return (height + kBandRows - 1) / kBandRows;
}

/// N arrays of one row.
template <typename T, std::size_t N>
struct Rows {
  std::array<std::vector<T>, N> row;
  explicit Rows(int width) {
    for (auto& r : row) r.resize(static_cast<std::size_t>(width));
  }
  void clear() {
    for (auto& r : row) std::fill(r.begin(), r.end(), T{0});
  }
};

Sums view(Rows<std::int32_t, 6>& rows) {
  auto& r = rows.row;
  return {r[0].data(), r[1].data(), r[2].data(), r[3].data(), r[4].data(), r[5].data()};
}

Moments view(Rows<float, 4>& rows) {
  auto& r = rows.row;
  return {r[0].data(), r[1].data(), r[2].data(), r[3].data()};
}

/// Windowed means of what is known. A pixel far from its window's mean keeps its own value; one
/// with too few neighbours becomes NaN.
class Smoother {
 public:
  Smoother(const cv::Mat1i& offset_256ths, const RefinementParameters& parameters, Simd simd)
      : from_(offset_256ths),
        radius_(parameters.radius_px),
        least_(static_cast<int>(parameters.support_min *
                                static_cast<float>((2 * radius_ + 1) * (2 * radius_ + 1)))),
        simd_(simd),
        sum_(from_.cols),
        count_(from_.cols),
        window_sum_(from_.cols),
        window_count_(from_.cols),
        scratch_(static_cast<std::size_t>(3 * (from_.cols + 64))) {}

  void band(int start, int end, float near_px, cv::Mat1f& out) {
    std::fill(sum_.begin(), sum_.end(), 0);
    std::fill(count_.begin(), count_.end(), 0);
    for (int y = start - radius_; y < start + radius_; ++y) add(y, 1);
    for (int y = start; y < end; ++y) {
      add(y + radius_, 1);
      window_sum(sum_.data(), from_.cols, radius_, scratch_.data(), window_sum_.data(), simd_);
      window_sum(count_.data(), from_.cols, radius_, scratch_.data(), window_count_.data(), simd_);
      smooth_row(from_[y], window_sum_.data(), window_count_.data(), from_.cols, least_, near_px,
                 out[y], simd_);
      add(y - radius_, -1);
    }
  }

 private:
  struct Buffer : std::vector<std::int32_t> {
    explicit Buffer(int width) : std::vector<std::int32_t>(static_cast<std::size_t>(width)) {}
  };

  void add(int y, int sign) {
    if (y < 0 || y >= from_.rows) return;
    add_offsets(from_[y], from_.cols, sign, sum_.data(), count_.data(), simd_);
  }

  const cv::Mat1i& from_;
  int radius_, least_;
  Simd simd_;
  Buffer sum_, count_, window_sum_, window_count_;
  std::vector<std::int32_t> scratch_;
};

/// Left over right: the ratio of the mean absolute slopes along matched rows, in a sample.
float gain_of(const ShotPair& shot, const cv::Mat1f& offset_px) {
  double left = 0, right = 0;
  for (int y = 4; y < offset_px.rows; y += 8)
    for (int x = 4; x + 4 < offset_px.cols; x += 4) {
      const float offset = offset_px(y, x);
      if (std::isnan(offset)) continue;
      const int at = x + static_cast<int>(std::lrintf(offset));
      if (at < 2 || at + 2 >= shot.right.cols) continue;
      left += std::abs(shot.left(y, x + 2) - shot.left(y, x - 2));
      right += std::abs(shot.right(y, at + 2) - shot.right(y, at - 2));
    }
  return left > 0 && right > 0 ? static_cast<float>(std::clamp(left / right, 0.25, 4.0)) : 1.F;
}

/// The residuals of one shot in the 2·radius + 1 rows around the current one, and their sums.
class ShotWindow {
 public:
  ShotWindow(const ShotPair& shot, float gain, const cv::Mat1f& offset_px, int radius, Simd simd)
      : shot_(shot),
        gain_(gain),
        offset_px_(offset_px),
        radius_(radius),
        simd_(simd),
        column_(shot.left.cols),
        window_(shot.left.cols),
        scratch_(static_cast<std::size_t>(3 * (shot.left.cols + 64))),
        ring_(static_cast<std::size_t>(2 * radius + 1), Rows<std::int16_t, 3>(shot.left.cols)) {}

  void start(int y) {
    column_.clear();
    for (int row = y - radius_; row < y + radius_; ++row) enter(row);
  }
  /// Adds what the windows around row y say.
  void advance(int y, const Moments& moments) {
    enter(y + radius_);
    for (std::size_t i = 0; i < column_.row.size(); ++i)
      window_sum(column_.row[i].data(), shot_.left.cols, radius_, scratch_.data(),
                 window_.row[i].data(), simd_);
    add_moments(view(window_), shot_.left.cols, moments, simd_);
    if (is_inside(y - radius_))
      add_products(residuals(y - radius_), shot_.left.cols, -1, view(column_), simd_);
  }

 private:
  [[nodiscard]] bool is_inside(int y) const { return y >= 0 && y < shot_.left.rows; }
  Residuals residuals(int y) {
    auto& row = ring_[static_cast<std::size_t>(y) % ring_.size()].row;
    return {row[0].data(), row[1].data(), row[2].data()};
  }
  void enter(int y) {
    if (!is_inside(y)) return;
    const Images images{shot_.left[y], shot_.right[y], shot_.left.cols, shot_.right.cols, gain_};
    residual_row(images, offset_px_[y], residuals(y), simd_);
    add_products(residuals(y), shot_.left.cols, 1, view(column_), simd_);
  }

  const ShotPair& shot_;
  float gain_;
  const cv::Mat1f& offset_px_;
  int radius_;
  Simd simd_;
  Rows<std::int32_t, 6> column_, window_;
  std::vector<std::int32_t> scratch_;
  std::vector<Rows<std::int16_t, 3>> ring_;
};

/// Half the noise's variance is in a central difference; the mean of both views' has half of that.
float gradient_noise(const cv::Mat1b& image) {
  const double noise = kScale * noise_of(image);
  return static_cast<float>(noise * noise / 4);
}

/// One fit of every pixel around `start_px`.
void fit(std::span<const ShotPair> shots, const cv::Mat1f& start_px,
         const RefinementParameters& parameters, WorkerPool& pool, RefinedOffsets& out, Simd simd) {
  const int width = start_px.cols, height = start_px.rows, size = 2 * parameters.radius_px + 1;
  const Limits limits{
      1 / (parameters.prior_sigma_px * parameters.prior_sigma_px), parameters.step_max_px,
      parameters.support_min * static_cast<float>(size * size) * static_cast<float>(shots.size()),
      gradient_noise(shots[0].left)};
  std::vector<float> gains;
  for (const ShotPair& shot : shots) gains.push_back(gain_of(shot, start_px));
  pool.run(bands_of(height), [&](int band) {
    const int start = band * kBandRows, end = std::min(start + kBandRows, height);
    std::vector<ShotWindow> windows;
    for (std::size_t i = 0; i < shots.size(); ++i)
      windows.emplace_back(shots[i], gains[i], start_px, parameters.radius_px, simd).start(start);
    Rows<float, 4> moments(width);
    for (int y = start; y < end; ++y) {
      moments.clear();
      for (ShotWindow& window : windows) window.advance(y, view(moments));
      std::copy_n(start_px[y], width, out.offset_px[y]);
      solve_row(view(moments), width, limits, out.offset_px[y], out.variance_px2[y], simd);
    }
  });
}

}  // namespace

void refine_offsets(std::span<const ShotPair> shots, const cv::Mat1i& offset_256ths,
                    const RefinementParameters& parameters, WorkerPool& pool, RefinedOffsets& out,
                    Simd simd) {
  const int bands = bands_of(offset_256ths.rows);
  out.offset_px.create(offset_256ths.size());
  out.variance_px2.create(offset_256ths.size());
  cv::Mat1f smooth(offset_256ths.size());
  cv::Mat1i again;
  for (int iteration = 0; iteration < parameters.iterations; ++iteration) {
    const cv::Mat1i& from = iteration == 0 ? offset_256ths : again;
    const float near_px = iteration == 0 ? parameters.start_near_px : kNearPx;
    pool.run(bands, [&](int band) {
      const int start = band * kBandRows, end = std::min(start + kBandRows, from.rows);
      Smoother(from, parameters, simd).band(start, end, near_px, smooth);
    });
    fit(shots, smooth, parameters, pool, out, simd);
    if (iteration + 1 == parameters.iterations) break;
    again.create(from.size());
    pool.run(bands, [&](int band) {
      const int end = std::min((band + 1) * kBandRows, from.rows);
      for (int y = band * kBandRows; y < end; ++y)
        quantise_row(out.offset_px[y], from.cols, again[y], simd);
    });
  }
}

}  // namespace holdfast::registration
