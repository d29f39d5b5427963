// SPDX-License-Identifier: Apache-2.0
// Parts of the left view found again in the pattern that was projected, each next to one that was
// found before: which pixel of the projector lit which point of the surface.
#pragma once

#include <vector>

#include <opencv2/core.hpp>

#include "registration/reconstruction.hpp"

namespace holdfast::registration {

struct AnchorSearch {
  /// Camera pixels for one of the projector, and how far it may be rolled against the camera.
  double scale_min = 1.5, scale_max = 7, turn_max_rad = 0.27;
};

struct PatternAnchor {
  cv::Vec3f p_mm;            ///< of the surface, rectified left
  cv::Point2d projector_px;  ///< that lit it
};

/// As find_projector(). Parts that hang together, wrong ones among them; nothing when the pattern
/// is not found.
[[nodiscard]] std::vector<PatternAnchor> find_anchors(const cv::Mat1b& pattern,
                                                      const cv::Mat1b& left,
                                                      const Reconstruction& surface,
                                                      const AnchorSearch& search = {});

}  // namespace holdfast::registration
