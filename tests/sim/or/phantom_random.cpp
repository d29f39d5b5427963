// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/phantom_random.hpp"

#include <array>
#include <cmath>
#include <numbers>

namespace holdfast::sim {
namespace {

std::uint32_t mix(std::uint32_t h) noexcept {
  h ^= h >> 16U;
  h *= 0x7feb352dU;
  h ^= h >> 15U;
  h *= 0x846ca68bU;
  return h ^ (h >> 16U);
}

// One of Perlin's twelve edge directions, chosen by the lattice point.
float gradient(const Eigen::Vector3i& c, const Eigen::Vector3f& d, std::uint32_t seed) noexcept {
  const std::uint32_t h = mix(static_cast<std::uint32_t>(c.x()) * 0x9e3779b9U ^
                              mix(static_cast<std::uint32_t>(c.y()) * 0x85ebca6bU ^
                                  mix(static_cast<std::uint32_t>(c.z()) * 0xc2b2ae35U ^ seed))) %
                          12U;
  const float u = h < 8 ? d.x() : d.y();
  const float v = h < 4 ? d.y() : d.z();
  return ((h & 1U) != 0 ? -u : u) + ((h & 2U) != 0 ? -v : v);
}

float fade(float t) noexcept {
  return t * t * t * (t * (t * 6.F - 15.F) + 10.F);
}

}  // namespace

double PhantomRandom::uniform(double low, double high) {
  constexpr double kUnit = 1.0 / 9007199254740992.0;  // 2^-53
  return low + (high - low) * static_cast<double>(engine_() >> 11U) * kUnit;
}

double PhantomRandom::normal(double sigma) {
  const double radius = std::sqrt(-2.0 * std::log(1.0 - uniform(0, 1)));
  return sigma * radius * std::cos(2.0 * std::numbers::pi * uniform(0, 1));
}

float smooth_noise(const Eigen::Vector3f& p, std::uint32_t seed) noexcept {
  const Eigen::Vector3f floor = p.array().floor();
  const Eigen::Vector3i cell = floor.cast<int>();
  const Eigen::Vector3f d = p - floor;
  std::array<float, 8> corner{};
  for (int i = 0; i < 8; ++i) {
    const Eigen::Vector3i step{i & 1, (i >> 1) & 1, i >> 2};
    corner[static_cast<std::size_t>(i)] = gradient(cell + step, d - step.cast<float>(), seed);
  }
  const auto mix_pairs = [&corner](std::size_t count, float t) {
    for (std::size_t i = 0; i < count; ++i)
      corner[i] = corner[2 * i] + t * (corner[2 * i + 1] - corner[2 * i]);
  };
  mix_pairs(4, fade(d.x()));
  mix_pairs(2, fade(d.y()));
  mix_pairs(1, fade(d.z()));
  return corner[0];
}

}  // namespace holdfast::sim
