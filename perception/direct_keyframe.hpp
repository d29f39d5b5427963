// SPDX-License-Identifier: Apache-2.0
// Everything that the direct tracker makes of one keyframe, once: patches, witnesses, and those who
// align, follow, check and contradict.
#pragma once

#include <optional>

#include <opencv2/core.hpp>

#include "perception/direct_alignment.hpp"
#include "perception/direct_template.hpp"
#include "perception/feature_review.hpp"
#include "perception/frame_chain.hpp"
#include "perception/stillness_check.hpp"

namespace holdfast::perception {

struct GivenKeyframe {
  cv::Mat image;  ///< CV_8UC1 or BGR CV_8UC3, of the camera's size
  Site site;
  cv::Mat mask;  ///< CV_8UC1 of that size, 0: not used; or empty
};

struct DirectKeyframe {
  GivenKeyframe given;
  StillnessCheck stillness;
  DirectTemplate patches;
  TemplateLevel witnesses;
  DirectAligner aligner;  ///< has room for the patches
  FrameChain chain;
  FeatureReview features;
};

struct DirectKeyframeResult {
  std::optional<DirectKeyframe> keyframe;
  TrackingReason reason = TrackingReason::none;  ///< why there is none
};

/// `moving_half` (CV_8UC1 of half size, or empty): 0 where the image shows what is fixed to the
/// camera; nothing is taken from there. Takes up to half a second at 1080p. Any thread.
[[nodiscard]] DirectKeyframeResult make_direct_keyframe(const GivenKeyframe& given,
                                                        const cv::Mat& moving_half,
                                                        const CameraModel& camera,
                                                        const TrackerParameters& parameters);

}  // namespace holdfast::perception
