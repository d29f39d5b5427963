// SPDX-License-Identifier: Apache-2.0
// The reflection mask of paper B (section 2.2.3, Eq. 2), made together with the grey image, since
// both need every pixel once.
//
// Read as an exclusion, Eq. 2 would leave only the glints. It is a KEEP mask: a pixel is kept when
// I < tau_1 I_max or S > tau_2 S_max, so what goes is bright and unsaturated: the light's own
// colour. I is the luma, I_max its maximum in this image; S = (max - min) / max of the channels,
// S_max = 1, its full scale: any coloured dark pixel reaches it, so the image's own maximum would
// say nothing more. A grey frame has no saturation; there a glint is brighter than
// tau_intensity_grey I_max.
#pragma once

#include <opencv2/core.hpp>

#include "perception/tracker_parameters.hpp"

namespace holdfast::perception {

struct GreyAndMask {
  cv::Mat grey;       ///< CV_8UC1, the size of the image
  cv::Mat half;       ///< CV_8UC1, half the size (2x2 means; an odd last row or column is dropped)
  cv::Mat keep_half;  ///< CV_8UC1, the size of `half`: 255 = keep, 0 = glint, dilated
};

/// `image`: CV_8UC1 or BGR CV_8UC3, at least 2x2. Writes into `out`, reusing its memory. One thread
/// at a time per `out`.
void make_grey_and_mask(const cv::Mat& image, const ReflectionMaskParameters& parameters,
                        GreyAndMask& out);

}  // namespace holdfast::perception
