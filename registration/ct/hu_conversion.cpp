// SPDX-License-Identifier: Apache-2.0
#include "registration/ct/hu_conversion.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace holdfast::registration {
namespace {

constexpr int kLow = std::numeric_limits<std::int16_t>::min(),
              kHigh = std::numeric_limits<std::int16_t>::max();

bool is_whole(double value, double most) {
  return std::abs(value) <= most && value == std::floor(value);
}

/// What nearly every scanner writes; turned into vector code by the compiler.
template <class Stored>  // std::int16_t or std::uint16_t
bool convert_by_whole_numbers(const PixelLayout& layout, std::span<std::int16_t> values) {
  // Up drops the bits above the stored value, down those below it and extends the sign.
  const int up = 15 - layout.high_bit, down = 16 - layout.bits_stored;
  const int slope = static_cast<int>(layout.slope), intercept = static_cast<int>(layout.intercept);
  int lost = 0;
  for (std::int16_t& value : values) {
    const auto top = static_cast<Stored>(static_cast<std::uint16_t>(value) << up);
    const int hu = slope * (top >> down) + intercept;
    const int kept = std::min(std::max(hu, kLow), kHigh);
    lost |= hu ^ kept;
    value = static_cast<std::int16_t>(kept);
  }
  return lost != 0;
}

/// Any slope and intercept: each stored value that there can be is converted once.
bool convert_by_table(const PixelLayout& layout, std::span<std::int16_t> values) {
  const int shift = layout.high_bit + 1 - layout.bits_stored, span = 1 << layout.bits_stored;
  std::vector<std::int16_t> hu_of(static_cast<std::size_t>(span));
  std::vector<char> is_lost(hu_of.size());
  for (int bits = 0; bits < span; ++bits) {
    const int stored = layout.is_signed && bits >= span / 2 ? bits - span : bits;
    const double hu = std::round(layout.slope * stored + layout.intercept);
    const double kept = std::clamp<double>(hu, kLow, kHigh);
    hu_of[static_cast<std::size_t>(bits)] = static_cast<std::int16_t>(kept);
    is_lost[static_cast<std::size_t>(bits)] = hu != kept ? 1 : 0;
  }
  int lost = 0;
  for (std::int16_t& value : values) {
    const auto bits =
        static_cast<std::size_t>((static_cast<std::uint16_t>(value) >> shift) & (span - 1));
    value = hu_of[bits];
    lost |= is_lost[bits];
  }
  return lost != 0;
}

}  // namespace

bool convert_to_hu(const PixelLayout& layout, std::span<std::int16_t> values) {
  // With these bounds no sum of the whole-number path overflows an int.
  if (!is_whole(layout.slope, 1 << 13) || !is_whole(layout.intercept, 1 << 30))
    return convert_by_table(layout, values);
  return layout.is_signed ? convert_by_whole_numbers<std::int16_t>(layout, values)
                          : convert_by_whole_numbers<std::uint16_t>(layout, values);
}

}  // namespace holdfast::registration
