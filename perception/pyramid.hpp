// SPDX-License-Identifier: Apache-2.0
// Grey, half, quarter: the image in the sizes that direct alignment works on, made in one pass
// while the rows are in the cache. A pixel of a smaller level is the rounded mean of 2x2 of the one
// above, so that level l has pixel i of the full image at (i + 0.5) / 2^l - 0.5.
#pragma once

#include <array>

#include <opencv2/core.hpp>

#include "perception/simd.hpp"

namespace holdfast::perception {

inline constexpr int kPyramidLevels = 3;

struct Pyramid {
  /// CV_8UC1 each. levels[0] of a grey image is that image itself, not a copy: it must live as long
  /// as the pyramid is used. Odd last rows and columns are dropped on the way down.
  std::array<cv::Mat, kPyramidLevels> levels;
  cv::Mat grey_memory;  ///< levels[0] of a colour image
};

/// `image`: CV_8UC1 or BGR CV_8UC3, at least 4x4 px. Writes into `out`, reusing its memory: no
/// allocation once the size has been seen. One thread at a time per `out`.
void make_pyramid(const cv::Mat& image, Pyramid& out, Simd simd = best_simd());

}  // namespace holdfast::perception
