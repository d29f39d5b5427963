// SPDX-License-Identifier: Apache-2.0
// Where a small patch of one image lies in another, to a small fraction of a pixel:
// inverse-compositional alignment in translation, blind to brightness and contrast.
#pragma once

#include <optional>

#include <opencv2/core.hpp>

namespace holdfast::perception {

struct AlignedPatch {
  cv::Point2d pixel;  ///< in the target image
  double zncc = 0;    ///< zero-mean normalised cross-correlation with the template, -1..1
};

/// Finds in `target` the 9x9 patch that lies around the whole pixel `centre` of `source` (both
/// CV_8UC1), starting at `start`; `warp` takes offsets in the source to offsets in the target.
/// Nothing when the patch has too little texture, leaves an image, moves more than `reach_px` from
/// the start, or does not settle. Thread-safe, no allocation.
[[nodiscard]] std::optional<AlignedPatch> align_patch(const cv::Mat& source, cv::Point centre,
                                                      const cv::Mat& target, cv::Point2d start,
                                                      const cv::Matx22d& warp, double reach_px);

}  // namespace holdfast::perception
