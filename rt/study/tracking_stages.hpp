// SPDX-License-Identifier: Apache-2.0
// What the studies of tracking share: from a rig's images to a camera, a depth map and the
// estimates of a sequence.
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "bridge/image_sequence.hpp"
#include "perception/camera_model.hpp"
#include "perception/motion_estimate.hpp"
#include "perception/site.hpp"
#include "registration/stereo_calibration.hpp"
#include "rt/study/rig.hpp"
#include "rt/study/stages.hpp"

namespace holdfast::rt {

using Tell = std::function<void(const std::string& what)>;

/// The left camera as calibrated, of the part of its image that the frames show.
[[nodiscard]] perception::CameraModel camera_of(const registration::ZoomCalibration& zoom,
                                                const cv::Rect& region_px);

/// Boards from the rig, calibrated; writes folder/stereo.yaml. One that stands there of the same
/// rig, zoom and pairs is taken as it is. Throws as calibrate_images().
[[nodiscard]] registration::ZoomCalibration calibrate_rig(Rig& rig, double zoom, int pairs,
                                                          const SetupParameters& setup,
                                                          const std::filesystem::path& folder,
                                                          const Tell& tell);

/// The depth under the keyframe (pose 0), on the whole left image's own grid, as `reconstruct`
/// delivers it under the adaptive pattern; its images stay in `out`. Throws RefusedError.
[[nodiscard]] cv::Mat1f reconstruct_rig(Rig& rig, const registration::ZoomCalibration& zoom,
                                        const SetupParameters& setup,
                                        const std::filesystem::path& out);

struct Followed {
  std::vector<perception::MotionEstimate> estimates;  ///< one a frame, from the keyframe's own on
  std::string refusal;                                ///< why there are none
};

/// Every frame of a folder, the first the keyframe. Throws as bridge::ImageSequence.
template <typename AnyTracker>
[[nodiscard]] Followed follow(AnyTracker tracker, const std::filesystem::path& frames,
                              const perception::SiteGeometry& geometry) {
  bridge::ImageSequence sequence(frames.string(), std::nullopt);
  Followed followed;
  while (const auto frame = sequence.next()) {
    if (frame->index == 0) {
      const perception::TrackingReason reason = tracker.set_keyframe(frame->image, geometry);
      if (reason != perception::TrackingReason::none) {
        followed.refusal = "the keyframe cannot serve: " + std::string(perception::name(reason));
        return followed;
      }
    }
    followed.estimates.push_back(tracker.track(frame->image, frame->t));
  }
  return followed;
}

/// poses.csv
[[nodiscard]] std::string poses_csv(const std::vector<perception::MotionEstimate>& estimates);

}  // namespace holdfast::rt
