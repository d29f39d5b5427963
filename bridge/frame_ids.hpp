// SPDX-License-Identifier: Apache-2.0
// How many frames lie between two frame ids. GigE Vision 1.x counts 1..65535 and skips 0 on
// wrapping; GigE Vision 2.x (extended ids) and USB3 Vision count in 64 bits. Pure.
#pragma once

#include <cstdint>
#include <optional>

namespace holdfast::bridge {

enum class FrameIdWidth : std::uint8_t { bits16, bits64 };

/// Frames missing between `previous` and `current`; 0 for successors. Empty when `current` repeats
/// `previous` or lies before it (for 16 bits: in the half of the circle behind it).
[[nodiscard]] constexpr std::optional<std::uint64_t> frames_between(std::uint64_t previous,
                                                                    std::uint64_t current,
                                                                    FrameIdWidth width) noexcept {
  if (width == FrameIdWidth::bits64) {
    if (current <= previous) return std::nullopt;
    return current - previous - 1;
  }
  constexpr std::uint64_t kCircle = 65535;  // 1..65535
  if (previous < 1 || previous > kCircle || current < 1 || current > kCircle) return std::nullopt;
  const std::uint64_t step = (current + kCircle - previous) % kCircle;
  if (step == 0 || step > kCircle / 2) return std::nullopt;
  return step - 1;
}

}  // namespace holdfast::bridge
