// SPDX-License-Identifier: Apache-2.0
// Centre-symmetric census: 31 comparisons of pixels that lie opposite each other in a 9x7 window,
// one bit each. Blind to exposure and gain; the matching cost is the count of differing bits. Of
// several shots with different patterns each gives its share of the bits (a burst).
#pragma once

#include <cstdint>
#include <span>

#include <opencv2/core.hpp>

#include "registration/simd.hpp"
#include "registration/worker_pool.hpp"

namespace holdfast::registration {

constexpr int kCensusMarginPx = 4;  ///< nearer to the image's sides the window is not complete

/// One word a pixel (CV_32SC1, bit 31 clear), as large as the images; pixels at the border repeat
/// the nearest whole window. `shots` are CV_8UC1 of one size, at least 9x7; 1 to 31 of them.
/// A bit is set where one pixel is brighter than its opposite by more than `threshold`: above the
/// noise, so that flat areas look alike in both views and leave the word to their surroundings.
void census(std::span<const cv::Mat1b> shots, std::uint8_t threshold, WorkerPool& pool,
            cv::Mat1i& out, Simd simd = best_simd());

/// Standard deviation of the image's noise in grey levels, from second differences along its rows:
/// their 30th percentile, so that texture hardly counts.
[[nodiscard]] double noise_of(const cv::Mat1b& image);

/// The mean of 2x2 pixels, rounded: half the width and height (rounded down).
void halve(const cv::Mat1b& image, WorkerPool& pool, cv::Mat1b& out, Simd simd = best_simd());

}  // namespace holdfast::registration
