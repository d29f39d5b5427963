// SPDX-License-Identifier: Apache-2.0
#include "perception/motion_estimate.hpp"

namespace holdfast::perception {

std::string_view name(TrackingStatus status) noexcept {
  switch (status) {
    case TrackingStatus::tracking:
      return "tracking";
    case TrackingStatus::relocalised:
      return "relocalised";
    case TrackingStatus::degraded:
      return "degraded";
    case TrackingStatus::lost:
      return "lost";
  }
  return "unknown";
}

std::string_view name(TrackingReason reason) noexcept {
  switch (reason) {
    case TrackingReason::none:
      return "none";
    case TrackingReason::no_keyframe:
      return "no_keyframe";
    case TrackingReason::wrong_image_size:
      return "wrong_image_size";
    case TrackingReason::wrong_image_type:
      return "wrong_image_type";
    case TrackingReason::too_few_features:
      return "too_few_features";
    case TrackingReason::too_few_matches:
      return "too_few_matches";
    case TrackingReason::too_few_inliers:
      return "too_few_inliers";
    case TrackingReason::inliers_bunched:
      return "inliers_bunched";
    case TrackingReason::inconsistent_motion:
      return "inconsistent_motion";
    case TrackingReason::implausible_motion:
      return "implausible_motion";
    case TrackingReason::drift_disagreement:
      return "drift_disagreement";
    case TrackingReason::invalid_geometry:
      return "invalid_geometry";
    case TrackingReason::time_not_increasing:
      return "time_not_increasing";
    case TrackingReason::check_disagreement:
      return "check_disagreement";
    case TrackingReason::fixed_pattern:
      return "fixed_pattern";
    case TrackingReason::tie_doubtful:
      return "tie_doubtful";
    case TrackingReason::out_of_focus:
      return "out_of_focus";
    case TrackingReason::unchecked:
      return "unchecked";
  }
  return "unknown";
}

}  // namespace holdfast::perception
