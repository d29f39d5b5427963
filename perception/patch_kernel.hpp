// SPDX-License-Identifier: Apache-2.0
// The inner loop of direct alignment: an 8x8 patch of the image, sampled through an affine map, and
// its correlations with a template. Everything alignment needs to know of the pixels is in five
// sums.
#pragma once

#include <cstdint>

#include <opencv2/core.hpp>

#include "perception/simd.hpp"

namespace holdfast::perception {

inline constexpr int kPatchSide = 8, kPatchCount = kPatchSide * kPatchSide;

/// Values and gradients of a template, row by row; pixel (i, j) lies at (i - 3.5, j - 3.5) from the
/// centre. All three are free of their mean, and the gradients also of what is proportional to
/// `value`: brightness and contrast then cannot pass for motion.
struct alignas(32) PatchPixels {
  float value[kPatchCount];
  float gx[kPatchCount];
  float gy[kPatchCount];
};

/// With I the image sampled on the template's grid.
struct PatchSums {
  float i = 0, ii = 0;             ///< of I and its square
  float vi = 0, gxi = 0, gyi = 0;  ///< of I times value, gx, gy
};

enum class Interpolation : std::uint8_t {
  bilinear,
  bicubic  ///< Catmull-Rom: a quarter of the bilinear bias between pixels, at twice the time
};

/// Where the template lies in the image: its point (x, y) is at centre + A (x, y).
struct PatchPlace {
  double u_px = 0, v_px = 0;
  float a00 = 1, a01 = 0, a10 = 0, a11 = 1;
};

/// Whether patch_sums() stays inside an image of this size at this place.
[[nodiscard]] bool is_inside(const PatchPlace& place, int width_px, int height_px) noexcept;

/// `image`: CV_8UC1; `place` must be inside. Thread-safe, no allocation.
[[nodiscard]] PatchSums patch_sums(const cv::Mat& image, const PatchPlace& place,
                                   const PatchPixels& pixels, Interpolation interpolation,
                                   Simd simd) noexcept;

}  // namespace holdfast::perception
