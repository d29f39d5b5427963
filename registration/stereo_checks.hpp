// SPDX-License-Identifier: Apache-2.0
// What is measured on a stereo pair before it is believed.
#pragma once

#include <opencv2/core.hpp>

#include "registration/rectified_image.hpp"

namespace holdfast::registration {

struct Exposure {
  double bright_grey = 0;      ///< 99th percentile
  double saturated_share = 0;  ///< of the pixels
  double textured_share = 0;   ///< of 16x16 blocks whose contrast is clearly above the noise
};

/// Of a CV_8UC1 image, over a sample.
[[nodiscard]] Exposure exposure_of(const cv::Mat1b& image);

struct VerticalDisparity {
  double rms_px = 0;     ///< of the medians of 4x4 tiles
  double median_px = 0;  ///< right row - left row
  int samples = 0;
};

/// How far matched points lie off their rows, by least squares around a sample of the disparities.
/// `largest_px`: see RectifiedPair.
[[nodiscard]] VerticalDisparity vertical_disparity(const RectifiedPair& pair,
                                                   const cv::Mat1f& disparity_px, int largest_px);

}  // namespace holdfast::registration
