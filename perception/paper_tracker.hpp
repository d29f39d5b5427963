// SPDX-License-Identifier: Apache-2.0
// Paper B as published (section 2.2, Fig. 2): mask, ORB with 2000 features, brute-force matching,
// RANSAC for an affine motion from each frame to the next, cascaded (Eq. 3). For comparison only:
// it drifts, and a motion behind an occlusion is missed for ever, with nothing in it to notice.
//
// Two readings: Eq. 2 is a keep mask (perception/reflection_mask.hpp), and the position that Eq. 3
// follows is the image's centre, not its corner.
#pragma once

#include <memory>

#include <opencv2/core.hpp>

#include "perception/camera_model.hpp"
#include "perception/motion_estimate.hpp"
#include "perception/tracker.hpp"

namespace holdfast::perception {

class PaperTracker {
 public:
  /// As Tracker. Of the parameters only those of the mask count.
  PaperTracker(const CameraModel& camera, const TrackerParameters& parameters);
  ~PaperTracker();
  PaperTracker(PaperTracker&&) noexcept;
  PaperTracker& operator=(PaperTracker&&) noexcept;
  PaperTracker(const PaperTracker&) = delete;
  PaperTracker& operator=(const PaperTracker&) = delete;

  /// As Tracker::set_keyframe(); of the geometry only the depth at the image's centre counts, which
  /// makes pixels millimetres.
  [[nodiscard]] TrackingReason set_keyframe(const cv::Mat& image, const SiteGeometry& geometry,
                                            const cv::Mat& mask = {});

  /// The cascaded motion, planar, with a covariance of NaN: the method knows none. `tracking`
  /// whenever this frame and the one before give a model, whatever came earlier; `lost` otherwise.
  [[nodiscard]] MotionEstimate track(const cv::Mat& image, std::chrono::nanoseconds t_exposure);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace holdfast::perception
