// SPDX-License-Identifier: Apache-2.0
// Part of the kernel: sixteen points at once, and the arithmetic that all parts share.
#pragma once

#include "tests/sim/or/kernel/kernel.hpp"

namespace holdfast::sim::kernel::HOLDFAST_KERNEL_NAMESPACE {
namespace {

struct alignas(64) Lanes3 {
  float x[kLanes], y[kLanes], z[kLanes];
};

inline float dot(Vec3 a, Vec3 b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
inline Vec3 minus(Vec3 a, Vec3 b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}

inline float clamp(float v, float lo, float hi) {
  return v < lo ? lo : v > hi ? hi : v;
}

}  // namespace
}  // namespace holdfast::sim::kernel::HOLDFAST_KERNEL_NAMESPACE
