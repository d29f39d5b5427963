// SPDX-License-Identifier: Apache-2.0
// Part of the kernel: values between the pixels of an image.
#pragma once

#include "tests/sim/or/kernel/kernel.hpp"
#include "tests/sim/or/kernel/lanes.hpp"

namespace holdfast::sim::kernel::HOLDFAST_KERNEL_NAMESPACE {
namespace {

// Bilinear, with values at texel centres; the image goes on as its border does.
inline float texel(const Image& image, float x, float y) {
  x = clamp(x - 0.5F, 0, static_cast<float>(image.width) - 1.001F);
  y = clamp(y - 0.5F, 0, static_cast<float>(image.height) - 1.001F);
  const int ix = static_cast<int>(x), iy = static_cast<int>(y);
  const float fx = x - static_cast<float>(ix), fy = y - static_cast<float>(iy);
  const float* a = image.data + iy * image.width + ix;
  const float* b = a + image.width;
  const float top = a[0] + fx * (a[1] - a[0]), bottom = b[0] + fx * (b[1] - b[0]);
  return top + fy * (bottom - top);
}

}  // namespace
}  // namespace holdfast::sim::kernel::HOLDFAST_KERNEL_NAMESPACE
