// SPDX-License-Identifier: Apache-2.0
// Two pixels a register, one in each 128-bit lane: no instruction here crosses lanes. The number of
// blocks is a template parameter, so that a path's gains stay in registers.
#include "registration/sgm_rows_avx2.hpp"

#include <array>
#include <bit>
#include <cstring>
#include <utility>

#include <immintrin.h>

#define HOLDFAST_AVX2 __attribute__((target("avx2")))
#define HOLDFAST_AVX2_INLINE inline __attribute__((target("avx2"), always_inline))

namespace holdfast::registration::sgm::avx2 {
namespace {

/// The 16·N candidates of two pixels.
template <int N>
struct Lanes {
  __m256i v[static_cast<std::size_t>(N)];
};

HOLDFAST_AVX2_INLINE __m256i load(const std::uint8_t* low, const std::uint8_t* high) {
  return _mm256_inserti128_si256(
      _mm256_castsi128_si256(_mm_loadu_si128(reinterpret_cast<const __m128i*>(low))),
      _mm_loadu_si128(reinterpret_cast<const __m128i*>(high)), 1);
}

HOLDFAST_AVX2_INLINE void store(__m256i value, std::uint8_t* low, std::uint8_t* high) {
  _mm_storeu_si128(reinterpret_cast<__m128i*>(low), _mm256_castsi256_si128(value));
  _mm_storeu_si128(reinterpret_cast<__m128i*>(high), _mm256_extracti128_si256(value, 1));
}

/// pshufb's indices for a shift by -16 … 16, 0x80 (gives zero) outside: 16 bytes from 16 + shift.
constexpr std::array<std::uint8_t, 48> kShift = [] {
  std::array<std::uint8_t, 48> table{};
  for (int i = 0; i < 48; ++i)
    table[static_cast<std::size_t>(i)] =
        static_cast<std::uint8_t>(i >= 16 && i < 32 ? i - 16 : 0x80);
  return table;
}();

HOLDFAST_AVX2_INLINE const std::uint8_t* shift_by(int shift) {
  return kShift.data() + 16 + (shift < -16 ? -16 : shift > 16 ? 16 : shift);
}

/// The least byte of each lane, in all its bytes.
HOLDFAST_AVX2_INLINE __m256i least_in_lanes(__m256i v) {
  v = _mm256_min_epu8(v, _mm256_shuffle_epi32(v, 0x4e));
  v = _mm256_min_epu8(v, _mm256_shuffle_epi32(v, 0xb1));
  v = _mm256_min_epu8(v, _mm256_or_si256(_mm256_slli_epi32(v, 16), _mm256_srli_epi32(v, 16)));
  return _mm256_min_epu8(v, _mm256_or_si256(_mm256_slli_epi16(v, 8), _mm256_srli_epi16(v, 8)));
}

/// Gains become T; the pixels' own gains come back. `cost` has P2 added.
template <int N>
HOLDFAST_AVX2_INLINE Lanes<N> step(const Lanes<N>& cost, Lanes<N>& gains, __m256i p1, __m256i p2) {
  const __m256i zero = _mm256_setzero_si256();
  Lanes<N> path, t;
  __m256i least = _mm256_set1_epi8(-1);
  for (int k = 0; k < N; ++k) {
    const __m256i below =
        _mm256_alignr_epi8(gains.v[k], k > 0 ? gains.v[k > 0 ? k - 1 : 0] : zero, 15);
    const __m256i above =
        _mm256_alignr_epi8(k < N - 1 ? gains.v[k < N - 1 ? k + 1 : k] : zero, gains.v[k], 1);
    t.v[k] = _mm256_max_epu8(gains.v[k], _mm256_subs_epu8(_mm256_max_epu8(below, above), p1));
    path.v[k] = _mm256_sub_epi8(cost.v[k], t.v[k]);
    least = _mm256_min_epu8(least, path.v[k]);
  }
  const __m256i top = _mm256_add_epi8(least_in_lanes(least), p2);
  for (int k = 0; k < N; ++k) {
    gains.v[k] = t.v[k];
    path.v[k] = _mm256_subs_epu8(top, path.v[k]);
  }
  return path;
}

template <int N, bool HasBase>
HOLDFAST_AVX2 void along(const Row& row, const std::uint8_t* cost, Penalties penalties,
                         std::uint8_t* sum) {
  constexpr int kCount = kBlock * N;
  const __m256i p1 = _mm256_set1_epi8(static_cast<char>(penalties.p1));
  const __m256i p2 = _mm256_set1_epi8(static_cast<char>(penalties.p2));
  std::memset(sum, 0, static_cast<std::size_t>(row.width) * kCount);
  Lanes<N> gains{};
  for (int x = 0; x < row.width; ++x) {  // one lane from the left, the other from the right
    const int y = row.width - 1 - x;
    if (HasBase && x > 0)
      gains.v[0] = _mm256_shuffle_epi8(gains.v[0], load(shift_by(row.base[x] - row.base[x - 1]),
                                                        shift_by(row.base[y] - row.base[y + 1])));
    Lanes<N> with_p2;
    for (int k = 0; k < N; ++k)
      with_p2.v[k] =
          _mm256_add_epi8(load(cost + x * kCount + kBlock * k, cost + y * kCount + kBlock * k), p2);
    Lanes<N> t = gains;
    gains = step<N>(with_p2, t, p1, p2);
    for (int k = 0; k < N; ++k) {
      std::uint8_t *const a = sum + x * kCount + kBlock * k, *const b =
                                                                 sum + y * kCount + kBlock * k;
      store(_mm256_add_epi8(load(a, b), t.v[k]), a, b);
    }
  }
}

/// One path from the row above for pixels x and x + 1; its T is added to `sum`.
template <int N, bool HasBase>
HOLDFAST_AVX2_INLINE void from_above(const Lanes<N>& with_p2, const std::uint8_t* before,
                                     const std::uint8_t* shift0, const std::uint8_t* shift1,
                                     std::uint8_t* now, __m256i p1, __m256i p2, Lanes<N>& sum) {
  Lanes<N> t;
  for (int k = 0; k < N; ++k)
    t.v[k] = N == 1 ? _mm256_loadu_si256(reinterpret_cast<const __m256i*>(before))
                    : load(before + kBlock * k, before + kBlock * (N + k));
  if (HasBase) t.v[0] = _mm256_shuffle_epi8(t.v[0], load(shift0, shift1));
  const Lanes<N> gains = step<N>(with_p2, t, p1, p2);
  for (int k = 0; k < N; ++k) {
    sum.v[k] = _mm256_add_epi8(sum.v[k], t.v[k]);
    store(gains.v[k], now + kBlock * k, now + kBlock * (N + k));
  }
}

template <int N, bool HasBase>
HOLDFAST_AVX2 void down(const Row& row, const std::int16_t* before_base, const std::uint8_t* cost,
                        Penalties penalties, const Gains& before, const Gains& now,
                        std::uint8_t* sum) {
  constexpr int kCount = kBlock * N;
  const __m256i p1 = _mm256_set1_epi8(static_cast<char>(penalties.p1));
  const __m256i p2 = _mm256_set1_epi8(static_cast<char>(penalties.p2));
  for (int x = 0; x < row.width; x += 2) {
    const std::uint8_t* const c = cost + x * kCount;
    std::uint8_t* const s = sum + x * kCount;
    Lanes<N> with_p2, total;
    for (int k = 0; k < N; ++k) {
      with_p2.v[k] = _mm256_add_epi8(load(c + kBlock * k, c + kBlock * (N + k)), p2);
      total.v[k] = load(s + kBlock * k, s + kBlock * (N + k));
    }
    const std::uint8_t* shift[2][3] = {};
    if (HasBase)
      for (int i = 0; i < 2; ++i)
        for (int dx = -1; dx <= 1; ++dx) {
          const int other = x + i + dx;
          const int inside = other < 0 ? 0 : other >= row.width ? row.width - 1 : other;
          shift[i][dx + 1] = shift_by(row.base[x + i] - before_base[inside]);
        }
    const std::ptrdiff_t at = static_cast<std::ptrdiff_t>(x + 1) * kCount;
    from_above<N, HasBase>(with_p2, before.down + at, shift[0][1], shift[1][1], now.down + at, p1,
                           p2, total);
    from_above<N, HasBase>(with_p2, before.down_right + at - kCount, shift[0][0], shift[1][0],
                           now.down_right + at, p1, p2, total);
    from_above<N, HasBase>(with_p2, before.down_left + at + kCount, shift[0][2], shift[1][2],
                           now.down_left + at, p1, p2, total);
    for (int k = 0; k < N; ++k) store(total.v[k], s + kBlock * k, s + kBlock * (N + k));
  }
}

/// Differing bits of eight words.
HOLDFAST_AVX2_INLINE __m256i bits_of(__m256i words) {
  const __m256i nibble = _mm256_set1_epi8(15);
  const __m256i count = _mm256_setr_epi8(0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4, 0, 1, 1, 2,
                                         1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4);
  const __m256i low = _mm256_shuffle_epi8(count, _mm256_and_si256(words, nibble));
  const __m256i high =
      _mm256_shuffle_epi8(count, _mm256_and_si256(_mm256_srli_epi32(words, 4), nibble));
  const __m256i pairs = _mm256_maddubs_epi16(_mm256_add_epi8(low, high), _mm256_set1_epi8(1));
  return _mm256_madd_epi16(pairs, _mm256_set1_epi16(1));
}

HOLDFAST_AVX2_INLINE void choose_pixel(const Row& row, int x, const std::uint8_t* cost,
                                       const std::uint8_t* sum, const Choice& out) {
  alignas(16) std::uint8_t value[kBlock * kBlocksMax + 2];
  const __m128i most = _mm_set1_epi8(static_cast<char>(255 - kPaths * kCostMax));
  __m128i v[kBlocksMax], least = _mm_set1_epi8(-1);
  const auto bottom = [](__m128i bytes) __attribute__((target("avx2"))) {
    const __m128i words = _mm_min_epu8(bytes, _mm_srli_epi16(bytes, 8));
    return _mm_cvtsi128_si32(_mm_minpos_epu16(words)) & 0xff;
  };
  for (int k = 0; k < row.blocks; ++k) {
    const __m128i c = _mm_loadu_si128(reinterpret_cast<const __m128i*>(cost + kBlock * k));
    const __m128i s = _mm_loadu_si128(reinterpret_cast<const __m128i*>(sum + kBlock * k));
    const __m128i five = _mm_add_epi8(c, _mm_add_epi8(_mm_add_epi8(c, c), _mm_add_epi8(c, c)));
    v[k] = _mm_sub_epi8(_mm_add_epi8(most, five), s);
    _mm_store_si128(reinterpret_cast<__m128i*>(value + kBlock * k), v[k]);
    least = _mm_min_epu8(least, v[k]);
  }
  const int best_value = bottom(least);
  const __m128i wanted = _mm_set1_epi8(static_cast<char>(best_value));
  int best = 0;
  for (int k = 0; k < row.blocks; ++k) {
    const int equal = _mm_movemask_epi8(_mm_cmpeq_epi8(v[k], wanted));
    if (equal != 0) {
      best = kBlock * k + std::countr_zero(static_cast<unsigned>(equal));
      break;
    }
  }
  // The others: all but the best and its neighbours.
  const __m128i steps = _mm_setr_epi8(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
  __m128i others = _mm_set1_epi8(-1);
  for (int k = 0; k < row.blocks; ++k) {
    const __m128i away =
        _mm_abs_epi8(_mm_sub_epi8(steps, _mm_set1_epi8(static_cast<char>(best - kBlock * k))));
    const __m128i is_near = _mm_cmpeq_epi8(_mm_min_epu8(away, _mm_set1_epi8(1)), away);
    others = _mm_min_epu8(others, _mm_or_si128(v[k], is_near));
  }
  int fraction = 0;
  if (best > 0 && best < kBlock * row.blocks - 1) {
    const int left = value[best - 1] - best_value, right = value[best + 1] - best_value;
    const int steeper = left > right ? left : right;
    if (steeper > 0) fraction = 8 * (left - right) / steeper;
  }
  const int base = row.base == nullptr ? 0 : row.base[x];
  out.candidate_16ths[x] = static_cast<std::int16_t>(16 * (base + best) + fraction);
  out.cost[x] = static_cast<std::uint8_t>(best_value);
  out.margin[x] = static_cast<std::uint8_t>(bottom(others) - best_value);
}

using AlongFunction = void (*)(const Row&, const std::uint8_t*, Penalties, std::uint8_t*);
using DownFunction = void (*)(const Row&, const std::int16_t*, const std::uint8_t*, Penalties,
                              const Gains&, const Gains&, std::uint8_t*);

template <int... N>
constexpr std::array<AlongFunction, sizeof...(N)> along_table(
    std::integer_sequence<int, N...> /*blocks*/) {
  return {along<N + 1, false>...};
}
template <int... N>
constexpr std::array<DownFunction, sizeof...(N)> down_table(
    std::integer_sequence<int, N...> /*blocks*/) {
  return {down<N + 1, false>...};
}
constexpr auto kAlong = along_table(std::make_integer_sequence<int, kBlocksMax>());
constexpr auto kDown = down_table(std::make_integer_sequence<int, kBlocksMax>());

}  // namespace

HOLDFAST_AVX2 void cost_row(const Row& row, const std::int32_t* left, const std::int32_t* right,
                            std::uint8_t* cost) {
  const __m128i most = _mm_set1_epi8(kCostMax);
  for (int x = 0; x < row.width; ++x) {
    const __m256i word = _mm256_set1_epi32(left[x]);
    const std::int32_t* candidate = right + x + (row.base == nullptr ? 0 : row.base[x]);
    for (int k = 0; k < row.blocks; ++k, candidate += kBlock, cost += kBlock) {
      const auto* words = reinterpret_cast<const __m256i*>(candidate);
      const __m256i first = bits_of(_mm256_xor_si256(word, _mm256_loadu_si256(words)));
      const __m256i second = bits_of(_mm256_xor_si256(word, _mm256_loadu_si256(words + 1)));
      const __m256i mixed = _mm256_packs_epi32(first, second);  // 0-3 8-11 | 4-7 12-15
      const __m256i inorder = _mm256_permute4x64_epi64(mixed, 0xd8);
      const __m128i bytes =
          _mm_packus_epi16(_mm256_castsi256_si128(inorder), _mm256_extracti128_si256(inorder, 1));
      _mm_storeu_si128(reinterpret_cast<__m128i*>(cost), _mm_min_epu8(bytes, most));
    }
  }
}

void aggregate_along(const Row& row, const std::uint8_t* cost, Penalties penalties,
                     std::uint8_t* sum) {
  const auto function =
      row.base != nullptr ? along<1, true> : kAlong[static_cast<std::size_t>(row.blocks - 1)];
  function(row, cost, penalties, sum);
}

void aggregate_down(const Row& row, const std::int16_t* before_base, const std::uint8_t* cost,
                    Penalties penalties, const Gains& before, const Gains& now, std::uint8_t* sum) {
  const auto function =
      row.base != nullptr ? down<1, true> : kDown[static_cast<std::size_t>(row.blocks - 1)];
  function(row, before_base, cost, penalties, before, now, sum);
}

HOLDFAST_AVX2 void choose(const Row& row, const std::uint8_t* cost, const std::uint8_t* sum,
                          const Choice& out) {
  const int count = kBlock * row.blocks;
  for (int x = 0; x < row.width; ++x) choose_pixel(row, x, cost + x * count, sum + x * count, out);
}

}  // namespace holdfast::registration::sgm::avx2
