// SPDX-License-Identifier: Apache-2.0
// The keyframe as features see it: each with the point of the site that it lies on.
#pragma once

#include <optional>
#include <vector>

#include "perception/motion_fit.hpp"

namespace holdfast::perception {

struct KeyframeView {
  View view;
  std::vector<Eigen::Vector3d> p_site_mm;  ///< of each feature
};

/// Features where the depth is known and neither `mask` (CV_8UC1 or empty) nor `moving_half` (of
/// half size, or empty) is 0. Nothing when they are fewer than HealthParameters::features_min.
/// Resets `detector` and lets it settle on this image.
[[nodiscard]] std::optional<KeyframeView> see_keyframe(
    const cv::Mat& image, const Site& site, const cv::Mat& mask, const cv::Mat& moving_half,
    const CameraModel& camera, const TrackerParameters& parameters, FeatureDetector& detector);

}  // namespace holdfast::perception
