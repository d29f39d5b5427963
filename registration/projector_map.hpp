// SPDX-License-Identifier: Apache-2.0
// Where the projector shines: decoded from one pair under a pattern whose image is known, so that
// no projector needs a calibration of its own: the parts of the left view that were found in the
// pattern (pattern_anchors.hpp) together give the projector as a camera.
#pragma once

#include <string>

#include <opencv2/core.hpp>

#include "registration/pattern_anchors.hpp"
#include "registration/reconstruction.hpp"

namespace holdfast::registration {

struct ProjectorLimits {
  AnchorSearch search;
  int anchors_min = 40;          ///< parts that agree
  double residual_max_px = 1.5;  ///< of their positions, rms, projector pixels
};

struct ProjectorMap {
  bool is_found = false;
  std::string evidence;  ///< when not: one clause with value and limit
  /// Projector pixels ~ projection (x, y, z, 1), of the rectified left frame, mm. Good near the
  /// surface it was decoded from, no further.
  cv::Matx34d projection = cv::Matx34d::zeros();
  int anchors = 0;         ///< parts of the image that it was fitted to
  double residual_px = 0;  ///< rms, projector pixels

  [[nodiscard]] cv::Point2d project(const cv::Vec3f& p_rectified_mm) const;
};

/// `pattern`: as projected, CV_8UC1; it must not repeat itself (no lattice). `left`: under it, on
/// the whole rectified left grid; `surface`: reconstructed from it, status done. A pattern that was
/// not projected, or another one, is not found. Deterministic; some seconds at worst.
[[nodiscard]] ProjectorMap find_projector(const cv::Mat1b& pattern, const cv::Mat1b& left,
                                          const Reconstruction& surface,
                                          const ProjectorLimits& limits = {});

}  // namespace holdfast::registration
