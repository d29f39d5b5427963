// SPDX-License-Identifier: Apache-2.0
// Real rectified pairs with ground truth that Debian packages carry: Middlebury's motorcycle
// (python3-skimage, sub-pixel truth) and Aloe (opencv-doc, whole pixels).
#pragma once

#include <opencv2/core.hpp>

#include "registration/stereo_matching.hpp"

namespace holdfast::test {

struct RealStereo {
  cv::Mat1b left, right;
  cv::Mat1f truth_px;  ///< disparity; NaN where unknown
  registration::DisparityRange range;
};

/// Empty images where the package is not installed.
[[nodiscard]] RealStereo motorcycle();
[[nodiscard]] RealStereo aloe();

/// The pair as the matcher wants it, padded; `range` must be whole.
[[nodiscard]] registration::RectifiedPair matchable(const RealStereo& pair,
                                                    const registration::MatchParameters& parameters,
                                                    registration::DisparityRange range);

struct DisparityErrors {
  double density = 0;   ///< of the pixels with truth
  double bad_2px = 0;   ///< share of the matched pixels that are more than 2 px wrong
  double good_2px = 0;  ///< share of all pixels with truth that are matched within 2 px
  double median_px = 0;
};
[[nodiscard]] DisparityErrors errors_of(const cv::Mat1f& disparity_px, const cv::Mat1f& truth_px);

}  // namespace holdfast::test
