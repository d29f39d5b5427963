// SPDX-License-Identifier: Apache-2.0
// Chance for the phantoms and their scans: the same seed gives the same numbers on every machine
// (the standard library's distributions do not promise that), and smooth noise over space.
#pragma once

#include <cstdint>
#include <random>

#include <Eigen/Core>

namespace holdfast::sim {

class PhantomRandom {
 public:
  explicit PhantomRandom(std::uint64_t seed) : engine_(seed) {}
  /// Uniform in [low, high).
  [[nodiscard]] double uniform(double low, double high);
  /// Gaussian of mean 0.
  [[nodiscard]] double normal(double sigma);
  [[nodiscard]] std::uint64_t bits() { return engine_(); }

 private:
  std::mt19937_64 engine_;
};

/// Gradient noise over space with features about one unit wide: smooth, mean 0, within -1..1,
/// standard deviation about 0.25. Pure; any thread.
[[nodiscard]] float smooth_noise(const Eigen::Vector3f& p, std::uint32_t seed) noexcept;

}  // namespace holdfast::sim
