// SPDX-License-Identifier: Apache-2.0
#include "registration/stereo_matching.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <vector>

#include <fmt/format.h>
#include <opencv2/calib3d.hpp>

#include "registration/census.hpp"
#include "registration/disparity_upsampling.hpp"
#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

using Clock = std::chrono::steady_clock;
using Images = std::vector<cv::Mat1b>;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr int kRowsPerTask = 32;
constexpr int kSpeckleStepIn16ths = 16;  // neighbours of one piece differ by at most a candidate

int tasks_of(int rows) {
  return (rows + kRowsPerTask - 1) / kRowsPerTask;
}

/// Both views of all shots on one level of the pyramid.
struct Level {
  Images left, right;
};

std::vector<Level> pyramid(std::span<const RectifiedPair> pairs, int coarsest, WorkerPool& pool,
                           Simd simd) {
  std::vector<Level> levels(static_cast<std::size_t>(coarsest) + 1);
  for (const RectifiedPair& pair : pairs) {
    levels[0].left.push_back(pair.left.pixels);
    levels[0].right.push_back(pair.right.pixels);
  }
  for (std::size_t k = 1; k < levels.size(); ++k)
    for (std::size_t i = 0; i < pairs.size(); ++i) {
      halve(levels[k - 1].left[i], pool, levels[k].left.emplace_back(), simd);
      halve(levels[k - 1].right[i], pool, levels[k].right.emplace_back(), simd);
    }
  return levels;
}

/// Candidates at either end of what was searched are no minima.
void drop_ends(const cv::Mat1s& base, int candidates, sgm::LevelResult& result) {
  for (int y = 0; y < result.cost.rows; ++y) {
    std::int16_t* const row = result.candidate_16ths[y];
    for (int x = 0; x < result.cost.cols; ++x) {
      const int j = (row[x] + 8) / 16 - (base.empty() ? 0 : base(y, x));
      const int last = base.empty() ? candidates - 1 : sgm::kBlock - 1;
      if (row[x] != sgm::kNone && (j <= 0 || j >= last)) row[x] = sgm::kNone;
    }
  }
}

/// Candidates of the finest matched level.
sgm::LevelResult match_pyramid(std::span<const Level> levels, DisparityRange range,
                               const MatchParameters& parameters, WorkerPool& pool, Simd simd) {
  const double noise = noise_of(levels[0].left[0]);
  sgm::LevelResult result;
  for (int k = parameters.coarsest_level; k >= parameters.finest_level; --k) {
    const Level& level = levels[static_cast<std::size_t>(k)];
    const double limit = parameters.census_threshold_sigma * noise / (1 << k);
    const auto threshold = static_cast<std::uint8_t>(
        std::clamp<long>(std::lround(limit), parameters.census_threshold_min, 32));
    cv::Mat1i left, right;
    census(level.left, threshold, pool, left, simd);
    census(level.right, threshold, pool, right, simd);
    const int candidates = range.count >> k;
    cv::Mat1s base;
    if (k < parameters.coarsest_level)
      sgm::search_windows(result.candidate_16ths, left.size(), candidates, pool, base);
    sgm::match_level(left, right, candidates / sgm::kBlock, base, parameters.penalties, pool,
                     result, simd);
    drop_ends(base, candidates, result);
  }
  return result;
}

/// Candidates beside a depth edge.
void drop_edges(int step_max_16ths, cv::Mat1s& candidate_16ths) {
  const cv::Mat1s from = candidate_16ths.clone();
  const auto is_step = [step_max_16ths](int own, int other) {
    return other != sgm::kNone && std::abs(own - other) > step_max_16ths;
  };
  for (int y = 0; y < from.rows; ++y)
    for (int x = 0; x < from.cols; ++x) {
      const int own = from(y, x);
      if (own == sgm::kNone) continue;
      for (int j = std::max(y - 1, 0); j <= std::min(y + 1, from.rows - 1); ++j)
        for (int i = std::max(x - 1, 0); i <= std::min(x + 1, from.cols - 1); ++i)
          if (is_step(own, from(j, i))) candidate_16ths(y, x) = sgm::kNone;
    }
}

void drop_uncertain(const MatchParameters& parameters, sgm::LevelResult& result) {
  for (int y = 0; y < result.cost.rows; ++y)
    for (int x = 0; x < result.cost.cols; ++x)
      if (result.margin(y, x) < parameters.margin_min) result.candidate_16ths(y, x) = sgm::kNone;
  const int smallest = parameters.speckle_min_px >> (2 * parameters.finest_level);
  cv::filterSpeckles(result.candidate_16ths, sgm::kNone, smallest, kSpeckleStepIn16ths);
  constexpr double kNoEdge = 1000;  // candidates; no range is as large
  if (parameters.edge_step_max < kNoEdge)
    drop_edges(static_cast<int>(16 * parameters.edge_step_max), result.candidate_16ths);
}

/// Of a level's pixels, the columns whose full-resolution pixels are all covered.
cv::Range covered_at(const RectifiedImage& image, int level, int y) {
  cv::Range covered(0, image.pixels.cols >> level);
  for (int row = y << level; row < (y + 1) << level; ++row) {
    const cv::Range here = image.covered[static_cast<std::size_t>(row)];
    covered.start = std::max(covered.start, (here.start + (1 << level) - 1) >> level);
    covered.end = std::min(covered.end, here.end >> level);
  }
  return covered;
}

/// The matched candidates as offsets, where both raw images have pixels.
cv::Mat1i offsets_of(const sgm::LevelResult& result, int level, const RectifiedPair& pair,
                     WorkerPool& pool) {
  const cv::Size size = result.candidate_16ths.size();
  cv::Mat1i offsets(size);
  pool.run(tasks_of(size.height), [&](int task) {
    const int end = std::min((task + 1) * kRowsPerTask, size.height);
    for (int y = task * kRowsPerTask; y < end; ++y) {
      const std::int16_t* const from = result.candidate_16ths[y];
      const cv::Range in_left = covered_at(pair.left, level, y);
      const cv::Range in_right = covered_at(pair.right, level, y);
      std::int32_t* const to = offsets[y];
      std::fill_n(to, size.width, kNoOffset);
      for (int x = in_left.start; x < in_left.end; ++x) {
        const int candidate_16ths = from[x], column = x + (candidate_16ths >> 4);
        const bool is_seen = candidate_16ths != sgm::kNone && column >= in_right.start + 1 &&
                             column < in_right.end - 2;
        if (is_seen) to[x] = candidate_16ths << 4;
      }
    }
  });
  return offsets;
}

/// From the matched candidates down to refined_level; `shots` become those of that level.
RefinedOffsets refine_pyramid(std::span<const Level> levels, cv::Mat1i offsets,
                              const MatchParameters& parameters, WorkerPool& pool, Simd simd,
                              std::vector<ShotPair>& shots) {
  RefinedOffsets refined;
  for (int k = parameters.finest_level; k >= parameters.refined_level; --k) {
    const Level& level = levels[static_cast<std::size_t>(k)];
    shots.clear();
    for (std::size_t i = 0; i < level.left.size(); ++i)
      shots.push_back({level.left[i], level.right[i]});
    if (k < parameters.finest_level) doubled(refined.offset_px, pool, offsets);
    const bool is_last = k == parameters.refined_level;
    refine_offsets(shots, offsets, is_last ? parameters.refinement : parameters.coarse_refinement,
                   pool, refined, simd);
  }
  return refined;
}

/// What became of the matched candidates: on the grid of finest_level, what was not even handed on
/// to the refinement; then, wherever the full grid has nothing, the first reason that applies.
void explain(const sgm::LevelResult& result, const cv::Mat1i& offsets, int level,
             const Repetition& repetition, int refined_level, DisparityMap& map) {
  const auto value = [](PixelReason reason) { return static_cast<uchar>(reason); };
  cv::Mat1b coarse(offsets.size());
  for (int y = 0; y < coarse.rows; ++y)
    for (int x = 0; x < coarse.cols; ++x)
      coarse(y, x) = value(result.candidate_16ths(y, x) == sgm::kNone ? PixelReason::unmatched
                           : offsets(y, x) == kNoOffset               ? PixelReason::outside
                                                                      : PixelReason::uncertain);
  map.reasons.create(map.disparity_px.size());
  for (int y = 0; y < map.reasons.rows; ++y)
    for (int x = 0; x < map.reasons.cols; ++x)
      map.reasons(y, x) =
          std::isnan(map.disparity_px(y, x))
              ? coarse(std::min(y >> level, coarse.rows - 1), std::min(x >> level, coarse.cols - 1))
              : value(PixelReason::known);
  for (const WindowFit& fit : repetition.windows) {
    if (!fit.is_ambiguous) continue;
    const cv::Rect cell(fit.cell_px.tl() * (1 << refined_level),
                        fit.cell_px.size() * (1 << refined_level));
    cv::Mat1b part = map.reasons(cell & cv::Rect({}, map.reasons.size()));
    part.setTo(value(PixelReason::repeating), part == value(PixelReason::uncertain));
  }
}

DisparityMap match_sgm(std::span<const RectifiedPair> pairs, DisparityRange range,
                       const MatchParameters& parameters, WorkerPool& pool, Simd simd) {
  const auto start = Clock::now();
  DisparityMap map;
  const auto levels = pyramid(pairs, parameters.coarsest_level, pool, simd);
  sgm::LevelResult result = match_pyramid(levels, range, parameters, pool, simd);
  drop_uncertain(parameters, result);
  const auto matched = Clock::now();
  std::vector<ShotPair> shots;
  const cv::Mat1i offsets = offsets_of(result, parameters.finest_level, pairs[0], pool);
  RefinedOffsets refined = refine_pyramid(levels, offsets, parameters, pool, simd, shots);
  const Repetition repetition =
      pattern_repetition(shots, refined.offset_px, range.count >> parameters.refined_level,
                         parameters.repetition, pool);
  map.ambiguous_share = repetition.ambiguous_share;
  for (const WindowFit& fit : repetition.windows)
    if (fit.is_ambiguous) refined.offset_px(fit.cell_px).setTo(static_cast<double>(kNan));
  const cv::Size size = pairs[0].left.pixels.size();
  map.disparity_px.create(size);
  map.variance_px2.create(size);
  map.confidence.create(size);
  UpsamplingParameters upsampling;
  upsampling.level = parameters.refined_level;
  upsampling.largest_px = static_cast<float>(range.minimum_px + range.count - 1);
  upsampling.variance_max = static_cast<float>(parameters.sigma_max_px * parameters.sigma_max_px) /
                            static_cast<float>(1 << (2 * parameters.refined_level));
  upsample({refined, result.margin, parameters.finest_level - parameters.refined_level}, upsampling,
           pool, {map.disparity_px, map.variance_px2, map.confidence}, simd);
  if (parameters.is_explained)
    explain(result, offsets, parameters.finest_level, repetition, parameters.refined_level, map);
  map.match_time = matched - start;
  map.refine_time = Clock::now() - matched;
  return map;
}

/// SGBM's own answer; the variance is that of its parabola as measured on Middlebury's motorcycle.
DisparityMap match_opencv(const RectifiedPair& pair, DisparityRange range) {
  constexpr int kBlockSize = 3;
  constexpr float kVariancePx2 = 0.1F;
  const auto start = Clock::now();
  const auto matcher =
      cv::StereoSGBM::create(0, range.count, kBlockSize, 8 * kBlockSize * kBlockSize,
                             32 * kBlockSize * kBlockSize, 1, 0, 10, 100, 2);
  // Its disparities count from the right view's first column: 0 <= d < count.
  cv::Mat1b left(pair.right.pixels.size(), uchar{0});
  pair.left.pixels.copyTo(left.colRange(range.count, left.cols));
  cv::Mat1s found;
  matcher->compute(left, pair.right.pixels, found);
  DisparityMap map;
  const cv::Size size = pair.left.pixels.size();
  map.disparity_px = cv::Mat1f(size, kNan);
  map.variance_px2 = cv::Mat1f(size, kNan);
  map.confidence = cv::Mat1f(size, 0.F);
  for (int y = 0; y < size.height; ++y) {
    const cv::Range covered = pair.left.covered[static_cast<std::size_t>(y)];
    const cv::Range in_right = pair.right.covered[static_cast<std::size_t>(y)];
    for (int x = covered.start; x < covered.end; ++x) {
      const int d_16ths = found(y, x + range.count);
      const int column = x + range.count - (d_16ths >> 4);
      if (d_16ths < 0 || column < in_right.start || column >= in_right.end) continue;
      map.disparity_px(y, x) =
          static_cast<float>(d_16ths) / 16 + static_cast<float>(range.minimum_px - 1);
      map.variance_px2(y, x) = kVariancePx2;
      map.confidence(y, x) = 1;
    }
  }
  map.match_time = Clock::now() - start;
  return map;
}

}  // namespace

MatchParameters match_parameters_for(cv::Size image_px) {
  constexpr int kSmallPx = 600'000, kLargePx = 2'000'000;
  MatchParameters parameters;
  const int pixels = image_px.area();
  parameters.coarsest_level = pixels < kSmallPx ? 0 : pixels < kLargePx ? 1 : 2;
  parameters.finest_level = pixels < kLargePx ? 0 : 2;
  parameters.refined_level = pixels < kLargePx ? 0 : 1;
  if (parameters.finest_level == 0) {
    parameters.refinement.radius_px = 4;
    parameters.margin_min = 3;
    parameters.sigma_max_px = 3;
  } else {
    parameters.refinement = {6, 1, 1.25F, 0.35F, 1.F, 0.15F};
    parameters.coarse_refinement = {4, 3, 1.25F, 0.35F, 1.F, 0.15F};
    parameters.penalties = {5, 20};
    parameters.census_threshold_min = 2;
    parameters.edge_step_max = 1.5;
    parameters.margin_min = 2;
    parameters.speckle_min_px = 800;
    parameters.sigma_max_px = 4;
  }
  return parameters;
}

DisparityRange whole_range(const MatchParameters& parameters, DisparityRange range) {
  const int unit = sgm::kBlock << parameters.coarsest_level;
  const int limit = unit * sgm::kBlocksMax;
  if (range.count < 1 || range.count > limit)
    throw InputError(
        fmt::format("disparity range of {} px, must be 1 … {} px", range.count, limit));
  const int count = (range.count + unit - 1) / unit * unit;
  return {range.minimum_px - (count - range.count) / 2, count};
}

cv::Size padded_size(const MatchParameters& parameters, cv::Size size) {
  const int whole = 1 << parameters.coarsest_level, even = 2 * whole;
  return {std::max((size.width + even - 1) / even * even, 16 * whole),
          std::max((size.height + whole - 1) / whole * whole, 16 * whole)};
}

DisparityMap match_disparity(std::span<const RectifiedPair> pairs, DisparityRange range,
                             const MatchParameters& parameters, WorkerPool& pool, Simd simd) {
  if (parameters.method == MatchMethod::opencv) return match_opencv(pairs[0], range);
  return match_sgm(pairs, range, parameters, pool, simd);
}

}  // namespace holdfast::registration
