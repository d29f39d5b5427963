// SPDX-License-Identifier: Apache-2.0
// Part of the kernel: whole rows of an image, from light to the sensor's numbers.
#pragma once

#include <cmath>
#include <cstdint>

#include "tests/sim/or/kernel/kernel.hpp"

namespace holdfast::sim::kernel::HOLDFAST_KERNEL_NAMESPACE {
namespace {

void filter_rows(const float* const* rows, const float* weights, int radius, int n, float* out) {
  const float* middle = rows[radius];
  const float w = weights[radius];
  for (int i = 0; i < n; ++i) out[i] = w * middle[i];
  for (int k = 1; k <= radius; ++k) {
    const float* a = rows[radius - k];
    const float* b = rows[radius + k];
    const float wk = weights[radius + k];
    for (int i = 0; i < n; ++i) out[i] += wk * (a[i] + b[i]);
  }
}

void filter_row(const float* in, const float* weights, int radius, int n, float* out) {
  const float w = weights[radius];
  for (int i = 0; i < n; ++i) out[i] = w * in[i];
  for (int k = 1; k <= radius; ++k) {
    const float* a = in - k;
    const float* b = in + k;
    const float wk = weights[radius + k];
    for (int i = 0; i < n; ++i) out[i] += wk * (a[i] + b[i]);
  }
}

void combine(const float* base, const float* microscope, const float* irradiance,
             const std::uint8_t* const* m, const std::uint8_t* const* p, int n, float* light,
             float* nir) {
  constexpr int kBlock = 256;
  std::uint8_t vertical_m[kBlock + 4], vertical_p[kBlock + 4];
  for (int start = 0; start < n; start += kBlock) {
    const int count = n - start < kBlock ? n - start : kBlock;
    for (int i = 0; i < count + 4; ++i) {
      const int j = start + i - 2;
      vertical_m[i] =
          static_cast<std::uint8_t>(m[0][j] + 2 * (m[1][j] + m[2][j] + m[3][j]) + m[4][j]);
      vertical_p[i] =
          static_cast<std::uint8_t>(p[0][j] + 2 * (p[1][j] + p[2][j] + p[3][j]) + p[4][j]);
    }
    for (int i = 0; i < count; ++i) {
      const int sum_m = vertical_m[i] +
                        2 * (vertical_m[i + 1] + vertical_m[i + 2] + vertical_m[i + 3]) +
                        vertical_m[i + 4];
      const int sum_p = vertical_p[i] +
                        2 * (vertical_p[i + 1] + vertical_p[i + 2] + vertical_p[i + 3]) +
                        vertical_p[i + 4];
      light[start + i] =
          base[start + i] + microscope[start + i] * static_cast<float>(sum_m) * 0.015625F;
      nir[start + i] = irradiance[start + i] * static_cast<float>(sum_p) * 0.015625F;
    }
  }
}

inline std::uint32_t scramble(std::uint32_t h) {
  h ^= h >> 16U;
  h *= 0x7feb352dU;
  h ^= h >> 15U;
  h *= 0x846ca68bU;
  return h ^ (h >> 16U);
}

void expose(const float* light, const float* deviates, std::uint64_t seed, float read, float shot,
            float full_scale, int n, std::uint16_t* out) {
  const auto low = static_cast<std::uint32_t>(seed), high = static_cast<std::uint32_t>(seed >> 32U);
  for (int i = 0; i < n; ++i) {
    const std::uint32_t h = scramble(scramble(static_cast<std::uint32_t>(i) ^ low) + high);
    const float value = light[i] > 0 ? light[i] : 0;
    const float noisy =
        value + std::sqrt(read * read + shot * shot * value) * deviates[h >> 16U] + 0.5F;
    const float clipped = noisy < 0 ? 0 : noisy > full_scale ? full_scale : noisy;
    out[i] = static_cast<std::uint16_t>(static_cast<int>(clipped));
  }
}

}  // namespace
}  // namespace holdfast::sim::kernel::HOLDFAST_KERNEL_NAMESPACE
