// SPDX-License-Identifier: Apache-2.0
// Part of the kernel: how a surface's albedo varies over it, by noise and by print.
#pragma once

#include <cmath>
#include <cstdint>

#include "tests/sim/or/kernel/kernel.hpp"
#include "tests/sim/or/kernel/lanes.hpp"
#include "tests/sim/or/kernel/texel.hpp"

namespace holdfast::sim::kernel::HOLDFAST_KERNEL_NAMESPACE {
namespace {

inline float fade(float t) {
  return t * t * t * (t * (t * 6 - 15) + 10);
}

inline float lerp(float a, float b, float t) {
  return a + t * (b - a);
}

inline float lattice(const float* table, float x, float y, float z) {
  constexpr int kMask = kTableSize - 1;
  const float fx = std::floor(x), fy = std::floor(y), fz = std::floor(z);
  const int ix = static_cast<int>(fx) & kMask, iy = (static_cast<int>(fy) & kMask) * kTableSize,
            iz = (static_cast<int>(fz) & kMask) * kTableSize * kTableSize;
  const int jx = (ix + 1) & kMask, jy = (iy + kTableSize) & (kMask * kTableSize),
            jz = (iz + kTableSize * kTableSize) & (kMask * kTableSize * kTableSize);
  const float u = fade(x - fx), v = fade(y - fy), w = fade(z - fz);
  const float near = lerp(lerp(table[iz + iy + ix], table[iz + iy + jx], u),
                          lerp(table[iz + jy + ix], table[iz + jy + jx], u), v);
  const float far = lerp(lerp(table[jz + iy + ix], table[jz + iy + jx], u),
                         lerp(table[jz + jy + ix], table[jz + jy + jx], u), v);
  return lerp(near, far, w);
}

// Two octaves, the second turned so that their lattices do not coincide.
void texture(const float* table, const Lanes3& p, const float* per_mm, const float* contrast,
             float* factor) {
  for (int i = 0; i < kLanes; ++i) {
    const float x = per_mm[i] * p.x[i], y = per_mm[i] * p.y[i], z = per_mm[i] * p.z[i];
    const float u = 1.36F * x + 1.28F * y + 0.96F * z + 11.3F;
    const float v = -1.6F * x + 1.36F * y + 0.4F * z + 5.7F;
    const float w = -0.4F * x - 0.96F * y + 1.84F * z + 17.1F;
    const float f =
        1 + contrast[i] * (0.8F * lattice(table, x, y, z) + 0.6F * lattice(table, u, v, w));
    factor[i] = f < 0.05F ? 0.05F : f > 3 ? 3 : f;
  }
}

// The print's mean over a pixel: 4x4 taps over its parallelogram on the surface.
float printed(const Surface& s, const std::uint32_t* triangle, float bu, float bv, Vec3 along_x,
              Vec3 along_y, float footprint) {
  const Vec3 a = s.vertices[triangle[0]];
  const Vec3 e1 = minus(s.vertices[triangle[1]], a), e2 = minus(s.vertices[triangle[2]], a);
  const float* t0 = s.uv + 2 * triangle[0];
  const float* t1 = s.uv + 2 * triangle[1];
  const float* t2 = s.uv + 2 * triangle[2];
  const float width = static_cast<float>(s.print.width),
              height = static_cast<float>(s.print.height);
  const float u1 = (t1[0] - t0[0]) * width, v1 = (t1[1] - t0[1]) * height;
  const float u2 = (t2[0] - t0[0]) * width, v2 = (t2[1] - t0[1]) * height;
  const float u = t0[0] * width + bu * u1 + bv * u2, v = t0[1] * height + bu * v1 + bv * v2;
  // Barycentric rates of a step in the plane, by the Gram matrix of the edges.
  const float g11 = dot(e1, e1), g12 = dot(e1, e2), g22 = dot(e2, e2);
  const float inverse = 1.F / (g11 * g22 - g12 * g12);
  float rates[2][2];
  const Vec3 steps[2] = {along_x, along_y};
  for (int i = 0; i < 2; ++i) {
    const float p = dot(steps[i], e1), q = dot(steps[i], e2);
    const float b1 = (g22 * p - g12 * q) * inverse, b2 = (g11 * q - g12 * p) * inverse;
    rates[i][0] = footprint * (b1 * u1 + b2 * u2);
    rates[i][1] = footprint * (b1 * v1 + b2 * v2);
  }
  float sum = 0;
  for (int j = 0; j < 4; ++j)
    for (int i = 0; i < 4; ++i) {
      const float cx = (static_cast<float>(i) - 1.5F) / 4, cy = (static_cast<float>(j) - 1.5F) / 4;
      sum += texel(s.print, u + cx * rates[0][0] + cy * rates[1][0],
                   v + cx * rates[0][1] + cy * rates[1][1]);
    }
  return sum / 16;
}

}  // namespace
}  // namespace holdfast::sim::kernel::HOLDFAST_KERNEL_NAMESPACE
