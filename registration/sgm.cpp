// SPDX-License-Identifier: Apache-2.0
#include "registration/sgm.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <vector>

namespace holdfast::registration::sgm {
namespace {

constexpr int kWarmUpRows = 24;        // rows above a band from which its paths come
constexpr int kBandRows = 256;         // about
constexpr int kToleranceIn16ths = 16;  // of the left-right check

int bands_of(int height) {
  return std::max(2, 2 * ((height + kBandRows) / (2 * kBandRows)));
}

/// What one band needs for itself.
struct Workspace {
  std::vector<std::uint8_t> cost, sum, gains[6];
  std::vector<std::uint8_t> right_cost;
  std::vector<std::int16_t> right_choice;

  Workspace(int width, int candidates, int right_width)
      : cost(static_cast<std::size_t>(width) * static_cast<std::size_t>(candidates)),
        sum(cost.size()),
        right_cost(static_cast<std::size_t>(right_width)),
        right_choice(right_cost.size()) {
    for (auto& path : gains)
      path.resize(static_cast<std::size_t>(width + 2) * static_cast<std::size_t>(candidates));
  }
  Gains now(bool is_odd) {
    const std::size_t i = is_odd ? 3 : 0;
    return {gains[i].data(), gains[i + 1].data(), gains[i + 2].data()};
  }
};

/// Of the pixels that chose one right pixel the best keeps it; others become kNone unless they
/// agree to a candidate.
void check_from_right(Workspace& work, const std::uint8_t* cost, int width, std::int16_t* choice) {
  std::fill(work.right_cost.begin(), work.right_cost.end(), std::uint8_t{255});
  const auto column = [&](int x) {
    const int right = x + ((choice[x] + 8) >> 4);
    return static_cast<std::size_t>(right);
  };
  for (int x = 0; x < width; ++x) {
    const std::size_t at = column(x);
    if (cost[x] >= work.right_cost[at]) continue;
    work.right_cost[at] = cost[x];
    work.right_choice[at] = choice[x];
  }
  for (int x = 0; x < width; ++x) {
    const std::size_t at = column(x);
    if (work.right_cost[at] == 255 ||
        std::abs(choice[x] - work.right_choice[at]) > kToleranceIn16ths)
      choice[x] = kNone;
  }
}

}  // namespace

void match_level(const cv::Mat1i& left, const cv::Mat1i& right, int blocks, const cv::Mat1s& base,
                 Penalties penalties, WorkerPool& pool, LevelResult& out, Simd simd) {
  const int width = left.cols, height = left.rows, bands = bands_of(height);
  const bool has_base = !base.empty();
  const int row_blocks = has_base ? 1 : blocks;
  out.candidate_16ths.create(left.size());
  out.cost.create(left.size());
  out.margin.create(left.size());
  pool.run(bands, [&](int band) {
    Workspace work(width, kBlock * row_blocks, right.cols + 1);
    const int start = height * band / bands, end = height * (band + 1) / bands;
    const int first = std::max(start - kWarmUpRows, 0);
    for (int y = first; y < end; ++y) {
      const Row row{width, row_blocks, has_base ? base[y] : nullptr};
      const Gains before = work.now(((y - first) & 1) == 0), now = work.now(((y - first) & 1) != 0);
      cost_row(row, left[y], right[y], work.cost.data(), simd);
      aggregate_along(row, work.cost.data(), penalties, work.sum.data(), simd);
      aggregate_down(row, has_base ? base[std::max(y - 1, 0)] : nullptr, work.cost.data(),
                     penalties, before, now, work.sum.data(), simd);
      if (y < start) continue;
      choose(row, work.cost.data(), work.sum.data(),
             {out.candidate_16ths[y], out.cost[y], out.margin[y]}, simd);
      check_from_right(work, out.cost[y], width, out.candidate_16ths[y]);
    }
  });
}

namespace {

/// Gaps take the neighbour that is further away from the camera: the larger candidate.
void fill_gaps(const std::int16_t* from, int width, std::int16_t* to) {
  std::int16_t before = kNone;
  for (int x = 0; x < width;) {
    if (from[x] != kNone) {
      before = to[x] = from[x];
      ++x;
      continue;
    }
    int end = x;
    while (end < width && from[end] == kNone) ++end;
    const std::int16_t after = end < width ? from[end] : kNone;
    std::fill(to + x, to + end, std::max(before, after));
    x = end;
  }
}

}  // namespace

void search_windows(const cv::Mat1s& candidate_16ths, cv::Size fine_size, int fine_candidates,
                    WorkerPool& pool, cv::Mat1s& base) {
  constexpr int kRowsPerTask = 32, kSpanMaxIn16ths = 5 * 16;
  const int width = candidate_16ths.cols, height = candidate_16ths.rows;
  base.create(fine_size);
  pool.run((height + kRowsPerTask - 1) / kRowsPerTask, [&](int task) {
    std::vector<std::int16_t> filled[3];
    for (auto& row : filled) row.resize(static_cast<std::size_t>(width));
    const auto fill = [&](int y) {
      const int inside = std::clamp(y, 0, height - 1);
      fill_gaps(candidate_16ths[inside], width, filled[(y + 3) % 3].data());
    };
    const int start = task * kRowsPerTask, end = std::min(start + kRowsPerTask, height);
    fill(start - 1);
    fill(start);
    for (int y = start; y < end; ++y) {
      fill(y + 1);
      const std::int16_t* const middle = filled[y % 3].data();
      for (int x = 0; x < width; ++x) {
        int least = 32767, most = -1;
        for (const auto& row : filled)
          for (int i = std::max(x - 1, 0); i <= std::min(x + 1, width - 1); ++i) {
            least = std::min<int>(least, row[static_cast<std::size_t>(i)]);
            most = std::max<int>(most, row[static_cast<std::size_t>(i)]);
          }
        const int centre_16ths = most - least <= kSpanMaxIn16ths ? (least + most) / 2 : middle[x];
        const int first = (2 * centre_16ths + 8) / 16 - kBlock / 2 + 1;
        const auto value =
            static_cast<std::int16_t>(std::clamp(first, 0, fine_candidates - kBlock));
        for (int i = 0; i < 2; ++i) {
          const int fine_y = std::min(2 * y + i, fine_size.height - 1);
          base(fine_y, std::min(2 * x, fine_size.width - 1)) = value;
          base(fine_y, std::min(2 * x + 1, fine_size.width - 1)) = value;
        }
      }
    }
  });
}

}  // namespace holdfast::registration::sgm
