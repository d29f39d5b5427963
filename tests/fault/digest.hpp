// SPDX-License-Identifier: Apache-2.0
// What a run of the world decided, as one number: two runs with the same number went alike,
// millisecond by millisecond. FNV-1a over words. The error counts to 0.1 um, so that the order in
// which a compiler adds does not show.
#pragma once

#include <cmath>
#include <cstdint>

#include "tests/fault/world.hpp"

namespace holdfast::fault {

class Digest {
 public:
  void add(std::uint64_t word) noexcept { value_ = (value_ ^ word) * 0x100000001B3U; }
  void add(const Observation& seen) noexcept {
    const auto code = [](auto e) { return static_cast<std::uint64_t>(e); };
    add(code(seen.is_permitted) | code(seen.is_withheld) << 1U | code(seen.mode) << 8U |
        code(seen.cause) << 16U | code(seen.refusal) << 24U | code(seen.guard_cause) << 32U);
    const bool is_number = std::abs(seen.error_mm) < 1e9;
    add(is_number ? static_cast<std::uint64_t>(std::llround(seen.error_mm * 1e4)) : ~0ULL);
  }
  [[nodiscard]] std::uint64_t value() const noexcept { return value_; }

 private:
  std::uint64_t value_ = 0xCBF29CE484222325U;
};

}  // namespace holdfast::fault
