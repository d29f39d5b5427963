// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/sensor_noise.hpp"

#include <cmath>
#include <vector>

#include <tbb/parallel_for.h>

#include "tests/sim/or/kernel/kernel.hpp"

namespace holdfast::sim {
namespace {

constexpr int kDeviates = 65536;

// Quantiles of the normal distribution at (i + 1/2) / kDeviates, by Newton's iteration.
std::vector<float> normal_quantiles() {
  std::vector<float> table(kDeviates);
  double z = -4.5;
  for (int i = 0; i < kDeviates; ++i) {
    const double p = (i + 0.5) / kDeviates;
    for (int step = 0; step < 50; ++step) {
      const double error = 0.5 * std::erfc(-z / std::sqrt(2.0)) - p;
      const double density = std::exp(-0.5 * z * z) / std::sqrt(2 * 3.14159265358979323846);
      const double change = std::clamp(error / density, -0.5, 0.5);
      z -= change;
      if (std::abs(change) < 1e-9) break;
    }
    table[static_cast<std::size_t>(i)] = static_cast<float>(z);
  }
  return table;
}

std::uint64_t mixed(std::uint64_t z) {
  z += 0x9e3779b97f4a7c15ULL;
  z = (z ^ (z >> 30U)) * 0xbf58476d1ce4e5b9ULL;
  z = (z ^ (z >> 27U)) * 0x94d049bb133111ebULL;
  return z ^ (z >> 31U);
}

}  // namespace

cv::Mat exposed(const cv::Mat_<float>& light, const SensorParameters& sensor, std::uint64_t seed) {
  static const std::vector<float> deviates = normal_quantiles();
  const float scale = sensor.bits == 12 ? 16.F : 1.F;
  const float full = sensor.bits == 12 ? 4095.F : 255.F;
  const auto read = static_cast<float>(sensor.read_noise_dn) * scale;
  const auto shot = static_cast<float>(sensor.shot_noise_dn) * std::sqrt(scale);
  cv::Mat image(light.size(), sensor.bits == 12 ? CV_16U : CV_8U);
  const kernel::Kernel& k = kernel::best_kernel();
  tbb::parallel_for(0, light.rows, [&](int y) {
    thread_local std::vector<float> scaled;
    thread_local std::vector<std::uint16_t> row;
    const auto n = static_cast<std::size_t>(light.cols);
    scaled.resize(n);
    row.resize(n);
    for (std::size_t x = 0; x < n; ++x) scaled[x] = scale * light[y][x];
    k.expose(scaled.data(), deviates.data(), mixed(mixed(seed) ^ static_cast<std::uint64_t>(y)),
             read, shot, full, light.cols, row.data());
    if (sensor.bits == 12)
      std::copy(row.begin(), row.end(), image.ptr<std::uint16_t>(y));
    else
      for (std::size_t x = 0; x < n; ++x)
        image.ptr<std::uint8_t>(y)[x] = static_cast<std::uint8_t>(row[x]);
  });
  return image;
}

}  // namespace holdfast::sim
