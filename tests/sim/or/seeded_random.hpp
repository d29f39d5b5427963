// SPDX-License-Identifier: Apache-2.0
// Chance for the microscope, boards and poses: the same seeds give the same numbers on every
// machine (the standard library's distributions do not promise that).
#pragma once

#include <cstdint>
#include <initializer_list>
#include <random>

namespace holdfast::sim {

class SeededRandom {
 public:
  /// Seeds that differ in any place give numbers that have nothing in common.
  SeededRandom(std::initializer_list<std::uint32_t> seeds) {
    std::seed_seq sequence(seeds);
    engine_.seed(sequence);
  }
  /// Uniform between the two, never exactly either.
  [[nodiscard]] double between(double low, double high) {
    return low + (high - low) * (static_cast<double>(engine_()) + 0.5) / 4294967296.0;
  }

 private:
  std::mt19937 engine_;
};

}  // namespace holdfast::sim
