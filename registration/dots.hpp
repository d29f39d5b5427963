// SPDX-License-Identifier: Apache-2.0
// The dots that a search chooses from.
#pragma once

#include <span>

namespace holdfast::registration {

/// Dots of `dot_px`, `distance_px` apart: the projector's pixels.
struct Dots {
  int distance_px = 1, dot_px = 2;
  friend bool operator==(const Dots&, const Dots&) = default;
};

/// d 1 … 10, s 2 … 16: 150 patterns.
[[nodiscard]] std::span<const Dots> all_dots();

}  // namespace holdfast::registration
