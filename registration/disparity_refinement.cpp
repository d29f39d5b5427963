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
  }
  /// After advance(y): the scores of the fit there, and nothing more of that row.
  void score(int y, const float* fitted_px, const Scores& scores) {
    add_scores(residuals(y), view(window_), offset_px_[y], fitted_px, shot_.left.cols, scores,
               simd_);
  }
  /// Takes the row out that the next windows do not have.
  void leave(int y) {
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

/// What a fit leaves for the variance.
struct Leftover {
  cv::Mat1i score, energy, moved;  // moved: the squared correction, in 1/256² px²
  cv::Mat1f per_score, of_start_px2;

  explicit Leftover(cv::Size size)
      : score(size), energy(size), moved(size), per_score(size), of_start_px2(size) {}
  Scores scores(int y) { return {score[y], energy[y]}; }
  Sensitivity sensitivity(int y) { return {per_score[y], of_start_px2[y]}; }
};

/// One fit of every pixel around `start_px`.
void fit(std::span<const ShotPair> shots, const cv::Mat1f& start_px,
         const RefinementParameters& parameters, WorkerPool& pool, cv::Mat1f& offset_px,
         Leftover& leftover, Simd simd) {
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
      std::copy_n(start_px[y], width, offset_px[y]);
      solve_row(view(moments), width, limits, offset_px[y], leftover.sensitivity(y), simd);
      moved_row(start_px[y], offset_px[y], width, leftover.moved[y], simd);
      std::fill_n(leftover.score[y], width, 0);
      std::fill_n(leftover.energy[y], width, 0);
      for (ShotWindow& window : windows) {
        window.score(y, offset_px[y], leftover.scores(y));
        window.leave(y);
      }
    }
  });
}

/// The variance of the offsets from how the fit's scores scatter: of their sums over blocks, so
/// that the noise's correlation and surfaces that do not fit the window are in it, and over a
/// larger window than the fit's, to know it well.
class VarianceOfScores {
 public:
  VarianceOfScores(Leftover& leftover, const RefinementParameters& parameters, Simd simd)
      : leftover_(leftover),
        radius_(std::min(2 * parameters.radius_px, kRadiusMax)),
        freedom_(freedom_of(parameters)),
        simd_(simd),
        width_(leftover.score.cols),
        rows_(width_),
        scratch_(static_cast<std::size_t>(3 * (width_ + 64))),
        ring_(static_cast<std::size_t>(2 * radius_ + 1), Rows<std::int32_t, 4>(width_)) {}

  void band(int start, int end, cv::Mat1f& variance_px2) {
    rows_.clear();
    for (int y = start - radius_ - kBlockRadiusPx; y < start - radius_ + kBlockRadiusPx; ++y)
      add_block_row(y, 1);
    for (int y = start - radius_; y < start + radius_; ++y) enter(y);
    for (int y = start; y < end; ++y) {
      enter(y + radius_);
      window_sum(squares(), width_, radius_, scratch_.data(), blocks(), simd_);
      window_sum(count(), width_, radius_, scratch_.data(), window_count(), simd_);
      window_sum(moved(), width_, radius_, scratch_.data(), window_moved(), simd_);
      window_sum(energy(), width_, radius_, scratch_.data(), window_energy(), simd_);
      variance_row({blocks(), window_energy(), window_moved(), window_count()},
                   leftover_.sensitivity(y), freedom_, width_, variance_px2[y], simd_);
      accumulate(y - radius_, -1);
    }
  }

 private:
  static constexpr int kRadiusMax = 10;

  /// A block's scores are not free: all of a window's sum up to nothing.
  static float freedom_of(const RefinementParameters& parameters) {
    const float share = static_cast<float>(2 * kBlockRadiusPx + 1) /
                        static_cast<float>(2 * parameters.radius_px + 1);
    return 1 - std::min(share * share, 0.8F);
  }
  std::int32_t* column() { return rows_.row[0].data(); }  // of scores, over a block's rows
  std::int32_t* blocks() { return rows_.row[1].data(); }
  std::int32_t* squares() { return rows_.row[2].data(); }  // over the window's rows
  std::int32_t* count() { return rows_.row[3].data(); }
  std::int32_t* window_count() { return rows_.row[4].data(); }
  std::int32_t* moved() { return rows_.row[5].data(); }
  std::int32_t* window_moved() { return rows_.row[6].data(); }
  std::int32_t* energy() { return rows_.row[7].data(); }
  std::int32_t* window_energy() { return rows_.row[8].data(); }
  [[nodiscard]] bool is_inside(int y) const { return y >= 0 && y < leftover_.score.rows; }

  void add_block_row(int y, int sign) {
    if (!is_inside(y)) return;
    const std::int32_t* const from = leftover_.score[y];
    for (int x = 0; x < width_; ++x) column()[x] += sign * from[x];
  }
  /// Row y of blocks, which needs the scores up to y + kBlockRadiusPx.
  void enter(int y) {
    add_block_row(y + kBlockRadiusPx, 1);
    if (is_inside(y)) {
      auto& row = ring_[static_cast<std::size_t>(y) % ring_.size()].row;
      window_sum(column(), width_, kBlockRadiusPx, scratch_.data(), blocks(), simd_);
      square_row(blocks(), width_, row[0].data(), simd_);
      const std::int32_t *const from = leftover_.moved[y], *const energies = leftover_.energy[y];
      for (int x = 0; x < width_; ++x) {
        const auto at = static_cast<std::size_t>(x);
        row[1][at] = from[x] >= 0 ? 1 : 0;
        row[2][at] = std::max(from[x], 0);
        row[3][at] = energies[x];
      }
      accumulate(y, 1);
    }
    add_block_row(y - kBlockRadiusPx, -1);
  }
  void accumulate(int y, int sign) {
    if (!is_inside(y)) return;
    const auto& row = ring_[static_cast<std::size_t>(y) % ring_.size()].row;
    const std::int32_t *const square = row[0].data(), *const n = row[1].data();
    const std::int32_t *const step = row[2].data(), *const energy_here = row[3].data();
    std::int32_t *const sum = squares(), *const all = count(), *const steps = moved();
    std::int32_t* const energies = energy();
    for (int x = 0; x < width_; ++x) {
      sum[x] += sign * square[x];
      all[x] += sign * n[x];
      steps[x] += sign * step[x];
      energies[x] += sign * energy_here[x];
    }
  }

  Leftover& leftover_;
  int radius_;
  float freedom_;
  Simd simd_;
  int width_;
  Rows<std::int32_t, 9> rows_;
  std::vector<std::int32_t> scratch_;
  std::vector<Rows<std::int32_t, 4>> ring_;
};

}  // namespace

void refine_offsets(std::span<const ShotPair> shots, const cv::Mat1i& offset_256ths,
                    const RefinementParameters& parameters, WorkerPool& pool, RefinedOffsets& out,
                    Simd simd) {
  const int bands = bands_of(offset_256ths.rows);
  out.offset_px.create(offset_256ths.size());
  out.variance_px2.create(offset_256ths.size());
  cv::Mat1f smooth(offset_256ths.size());
  cv::Mat1i again;
  Leftover leftover(offset_256ths.size());
  for (int iteration = 0; iteration < parameters.iterations; ++iteration) {
    const cv::Mat1i& from = iteration == 0 ? offset_256ths : again;
    const float near_px = iteration == 0 ? parameters.start_near_px : kNearPx;
    pool.run(bands, [&](int band) {
      const int start = band * kBandRows, end = std::min(start + kBandRows, from.rows);
      Smoother(from, parameters, simd).band(start, end, near_px, smooth);
    });
    fit(shots, smooth, parameters, pool, out.offset_px, leftover, simd);
    if (iteration + 1 == parameters.iterations) break;
    again.create(from.size());
    pool.run(bands, [&](int band) {
      const int end = std::min((band + 1) * kBandRows, from.rows);
      for (int y = band * kBandRows; y < end; ++y)
        quantise_row(out.offset_px[y], from.cols, again[y], simd);
    });
  }
  pool.run(bands, [&](int band) {
    const int start = band * kBandRows, end = std::min(start + kBandRows, smooth.rows);
    VarianceOfScores(leftover, parameters, simd).band(start, end, out.variance_px2);
  });
}

}  // namespace holdfast::registration
