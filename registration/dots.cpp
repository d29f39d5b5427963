// SPDX-License-Identifier: Apache-2.0
#include "registration/dots.hpp"

#include <array>

namespace holdfast::registration {
namespace {

constexpr int kDistances = 10, kSizes = 15, kSmallestDot = 2;

}  // namespace

std::span<const Dots> all_dots() {
  static const auto kept = [] {
    std::array<Dots, static_cast<std::size_t>(kDistances) * static_cast<std::size_t>(kSizes)> all;
    for (std::size_t i = 0; i < all.size(); ++i)
      all.at(i) = {static_cast<int>(i) / kSizes + 1, static_cast<int>(i) % kSizes + kSmallestDot};
    return all;
  }();
  return kept;
}

}  // namespace holdfast::registration
