// SPDX-License-Identifier: Apache-2.0
// The scalar reference of the loops, and the choice between it and AVX2.
#include "registration/sgm_rows.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cstdlib>

#include "registration/sgm_rows_avx2.hpp"

namespace holdfast::registration::sgm {
namespace {

using Block = std::array<std::uint8_t, kBlock * kBlocksMax>;

int base_of(const std::int16_t* base, int x) {
  return base == nullptr ? 0 : base[x];
}

/// One step of a path: the gains `before`, of a window `shift` candidates further up, become T and
/// the pixel's own gains.
void step(const std::uint8_t* cost, const std::uint8_t* before, int shift, int count,
          Penalties penalties, std::uint8_t* t, std::uint8_t* gains) {
  const auto gain = [&](int j) {
    return j + shift >= 0 && j + shift < count ? before[j + shift] : 0;
  };
  // A neighbour's neighbour outside the pixel's own window counts as unknown, as in the vectors.
  const auto neighbour = [&](int j) { return j >= 0 && j < count ? gain(j) : 0; };
  Block path{};
  int least = 255;
  for (int j = 0; j < count; ++j) {
    const int beside = std::max(neighbour(j - 1), neighbour(j + 1)) - penalties.p1;
    const int best = std::max({gain(j), beside, 0});
    t[j] = static_cast<std::uint8_t>(best);
    path[static_cast<std::size_t>(j)] = static_cast<std::uint8_t>(cost[j] + penalties.p2 - best);
    least = std::min<int>(least, path[static_cast<std::size_t>(j)]);
  }
  for (int j = 0; j < count; ++j)
    gains[j] = static_cast<std::uint8_t>(
        std::max(least + penalties.p2 - path[static_cast<std::size_t>(j)], 0));
}

void add(const Block& t, int count, std::uint8_t* sum) {
  for (int j = 0; j < count; ++j)
    sum[j] = static_cast<std::uint8_t>(sum[j] + t[static_cast<std::size_t>(j)]);
}

void cost_row_scalar(const Row& row, const std::int32_t* left, const std::int32_t* right,
                     std::uint8_t* cost) {
  const int count = kBlock * row.blocks;
  for (int x = 0; x < row.width; ++x)
    for (int j = 0; j < count; ++j) {
      const auto differing =
          static_cast<std::uint32_t>(left[x] ^ right[x + base_of(row.base, x) + j]);
      *cost++ = static_cast<std::uint8_t>(std::min(std::popcount(differing), kCostMax));
    }
}

void aggregate_along_scalar(const Row& row, const std::uint8_t* cost, Penalties penalties,
                            std::uint8_t* sum) {
  const int count = kBlock * row.blocks;
  std::fill_n(sum, row.width * count, std::uint8_t{0});
  for (const bool is_forward : {true, false}) {
    Block gains{}, t{};
    int before = is_forward ? 0 : row.width - 1;
    for (int i = 0; i < row.width; ++i) {
      const int x = is_forward ? i : row.width - 1 - i;
      const Block gains_before = gains;
      step(cost + x * count, gains_before.data(), base_of(row.base, x) - base_of(row.base, before),
           count, penalties, t.data(), gains.data());
      add(t, count, sum + x * count);
      before = x;
    }
  }
}

void aggregate_down_scalar(const Row& row, const std::int16_t* before_base,
                           const std::uint8_t* cost, Penalties penalties, const Gains& before,
                           const Gains& now, std::uint8_t* sum) {
  const int count = kBlock * row.blocks;
  const auto path = [&](int x, int dx, const std::uint8_t* from, std::uint8_t* to) {
    const int neighbour = std::clamp(x + dx, 0, row.width - 1);
    Block t{};
    step(cost + x * count, from + (x + dx + 1) * count,
         base_of(row.base, x) - base_of(before_base, neighbour), count, penalties, t.data(),
         to + (x + 1) * count);
    add(t, count, sum + x * count);
  };
  for (int x = 0; x < row.width; ++x) {
    path(x, 0, before.down, now.down);
    path(x, -1, before.down_right, now.down_right);
    path(x, 1, before.down_left, now.down_left);
  }
}

void choose_scalar(const Row& row, const std::uint8_t* cost, const std::uint8_t* sum,
                   const Choice& out) {
  const int count = kBlock * row.blocks;
  for (int x = 0; x < row.width; ++x, cost += count, sum += count) {
    const auto value = [&](int j) { return 255 - kPaths * (kCostMax - cost[j]) - sum[j]; };
    int best = 0, second = 255;
    for (int j = 1; j < count; ++j)
      if (value(j) < value(best)) best = j;
    for (int j = 0; j < count; ++j)
      if (std::abs(j - best) > 1) second = std::min(second, value(j));
    int fraction = 0;
    if (best > 0 && best < count - 1) {
      const int rise_left = value(best - 1) - value(best),
                rise_right = value(best + 1) - value(best);
      const int steeper = std::max(rise_left, rise_right);
      if (steeper > 0) fraction = 8 * (rise_left - rise_right) / steeper;
    }
    out.candidate_16ths[x] =
        static_cast<std::int16_t>(16 * (base_of(row.base, x) + best) + fraction);
    out.cost[x] = static_cast<std::uint8_t>(value(best));
    out.margin[x] = static_cast<std::uint8_t>(second - value(best));
  }
}

}  // namespace

void cost_row(const Row& row, const std::int32_t* left, const std::int32_t* right,
              std::uint8_t* cost, Simd simd) {
  (simd == Simd::avx2 ? avx2::cost_row : cost_row_scalar)(row, left, right, cost);
}

void aggregate_along(const Row& row, const std::uint8_t* cost, Penalties penalties,
                     std::uint8_t* sum, Simd simd) {
  (simd == Simd::avx2 ? avx2::aggregate_along : aggregate_along_scalar)(row, cost, penalties, sum);
}

void aggregate_down(const Row& row, const std::int16_t* before_base, const std::uint8_t* cost,
                    Penalties penalties, const Gains& before, const Gains& now, std::uint8_t* sum,
                    Simd simd) {
  (simd == Simd::avx2 ? avx2::aggregate_down : aggregate_down_scalar)(row, before_base, cost,
                                                                      penalties, before, now, sum);
}

void choose(const Row& row, const std::uint8_t* cost, const std::uint8_t* sum, const Choice& out,
            Simd simd) {
  (simd == Simd::avx2 ? avx2::choose : choose_scalar)(row, cost, sum, out);
}

}  // namespace holdfast::registration::sgm
