// SPDX-License-Identifier: Apache-2.0
#include "registration/pattern_repetition.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace holdfast::registration {
namespace {

constexpr double kMatchedMin = 0.3;  // a window that correlates less says nothing

/// Sums over one window's samples, of the right view for each of the offsets around the match.
class Correlations {
 public:
  explicit Correlations(int reach_px)
      : reach_(reach_px),
        right_(2 * static_cast<std::size_t>(reach_px) + 1),
        squares_(right_.size()),
        products_(right_.size()) {}

  void clear() {
    std::fill(right_.begin(), right_.end(), 0);
    std::fill(squares_.begin(), squares_.end(), 0);
    std::fill(products_.begin(), products_.end(), 0);
    n_ = left_ = left_squares_ = 0;
  }
  /// `right`: at the match; readable `reach` columns to both sides.
  void add(std::int32_t left, const std::uint8_t* right) {
    ++n_;
    left_ += left;
    left_squares_ += left * left;
    const std::uint8_t* const from = right - reach_;
    std::int32_t *const sum = right_.data(), *const square = squares_.data(),
                        *const product = products_.data();
    const int count = 2 * reach_ + 1;
#pragma GCC ivdep
    for (int i = 0; i < count; ++i) {
      const std::int32_t grey = from[i];
      sum[i] += grey;
      square[i] += grey * grey;
      product[i] += left * grey;
    }
  }
  [[nodiscard]] int samples() const {
    return n_;
  }
  [[nodiscard]] int reach() const {
    return reach_;
  }
  /// At `offset` from the match.
  [[nodiscard]] double at(int offset) const {
    const int index = offset + reach_;
    const auto i = static_cast<std::size_t>(index);
    const double n = n_, left = left_, right = right_[i];
    const double of_left = n * left_squares_ - left * left;
    const double of_right = n * squares_[i] - right * right;
    const double both = n * products_[i] - left * right;
    // A grey level's rounding, so that flat windows correlate with nothing.
    return both / std::sqrt((of_left + n * n / 12) * (of_right + n * n / 12));
  }

 private:
  int reach_, n_ = 0;
  std::int32_t left_ = 0, left_squares_ = 0;  // 441 · 255² fits
  std::vector<std::int32_t> right_, squares_, products_;
};

void add_window(const ShotPair& shot, const cv::Mat1f& offset_px, cv::Point centre,
                const RepetitionParameters& parameters, Correlations& correlations) {
  const int radius = parameters.radius_px, reach = correlations.reach();
  for (int y = std::max(centre.y - radius, 0); y <= std::min(centre.y + radius, offset_px.rows - 1);
       y += parameters.step_px)
    for (int x = std::max(centre.x - radius, 0);
         x <= std::min(centre.x + radius, offset_px.cols - 1); x += parameters.step_px) {
      const float offset = offset_px(y, x);
      if (std::isnan(offset)) continue;
      const int at = x + static_cast<int>(std::lrintf(offset));
      if (at - reach < 0 || at + reach >= shot.right.cols) continue;
      correlations.add(shot.left(y, x), shot.right[y] + at);
    }
}

/// Beyond the match's own peak: where the correlation has fallen and rises again.
WindowFit judge(const Correlations& correlations, const RepetitionParameters& parameters) {
  WindowFit fit;
  fit.matched = std::max({correlations.at(-1), correlations.at(0), correlations.at(1)});
  for (const int side : {-1, 1}) {
    int i = 1;
    double before = fit.matched;
    for (; i <= correlations.reach(); ++i) {
      const double here = correlations.at(side * i);
      if (here > before) break;
      before = here;
    }
    for (; i <= correlations.reach(); ++i) {
      const double here = correlations.at(side * i);
      if (here <= fit.rival) continue;
      fit.rival = here;
      fit.rival_offset_px = side * i;
    }
  }
  fit.is_ambiguous = fit.rival >= parameters.correlation_min &&
                     1 - fit.rival <= parameters.unexplained_ratio_max * (1 - fit.matched);
  return fit;
}

/// The image in `cells`, whose last ones reach the image's ends.
cv::Rect cell_of(cv::Size size, cv::Size cells, cv::Point at) {
  const int x = size.width * at.x / cells.width, y = size.height * at.y / cells.height;
  return {x, y, size.width * (at.x + 1) / cells.width - x,
          size.height * (at.y + 1) / cells.height - y};
}

}  // namespace

Repetition pattern_repetition(std::span<const ShotPair> shots, const cv::Mat1f& offset_px,
                              int reach_px, const RepetitionParameters& parameters,
                              WorkerPool& pool) {
  const int columns = offset_px.cols / parameters.grid_px,
            rows = offset_px.rows / parameters.grid_px;
  const int side = 2 * parameters.radius_px / parameters.step_px + 1;
  const int samples_min = side * side * static_cast<int>(shots.size()) / 4;
  std::vector<std::optional<WindowFit>> found(static_cast<std::size_t>(columns) *
                                              static_cast<std::size_t>(rows));
  pool.run(rows, [&](int row) {
    Correlations correlations(reach_px);
    for (int column = 0; column < columns; ++column) {
      const cv::Rect cell = cell_of(offset_px.size(), {columns, rows}, {column, row});
      correlations.clear();
      for (const ShotPair& shot : shots)
        add_window(shot, offset_px, (cell.tl() + cell.br()) / 2, parameters, correlations);
      if (correlations.samples() < samples_min) continue;
      WindowFit fit = judge(correlations, parameters);
      fit.cell_px = cell;
      if (fit.matched >= kMatchedMin)
        found[static_cast<std::size_t>(row) * static_cast<std::size_t>(columns) +
              static_cast<std::size_t>(column)] = fit;
    }
  });
  Repetition result;
  for (const auto& fit : found)
    if (fit) result.windows.push_back(*fit);
  const auto ambiguous = std::count_if(result.windows.begin(), result.windows.end(),
                                       [](const WindowFit& fit) { return fit.is_ambiguous; });
  if (!result.windows.empty())
    result.ambiguous_share =
        static_cast<double>(ambiguous) / static_cast<double>(result.windows.size());
  return result;
}

}  // namespace holdfast::registration
