// SPDX-License-Identifier: Apache-2.0
// The tracker of the house: direct 6-DoF alignment of every frame to the keyframe with its depth.
// Beside it, and never part of the estimate: the cascaded motion from frame to frame, and ORB
// features against the keyframe, which check it, and find the site again when it is lost.
//
//   predict (constant velocity, or still; after a jolt by phase correlation) -> align -> judge
//   -> compare with the chain -> compare with the features, every so many frames
//
// Nothing of an earlier frame enters an estimate but where its search begins.
#pragma once

#include <memory>
#include <span>

#include <opencv2/core.hpp>

#include "perception/camera_model.hpp"
#include "perception/motion_estimate.hpp"
#include "perception/tracker.hpp"

namespace holdfast::perception {

class DirectTracker {
 public:
  /// As Tracker: throws std::invalid_argument, in one line, for what invalid_camera() or
  /// invalid_parameter() would name.
  DirectTracker(const CameraModel& camera, const TrackerParameters& parameters);
  ~DirectTracker();
  DirectTracker(DirectTracker&&) noexcept;
  DirectTracker& operator=(DirectTracker&&) noexcept;
  DirectTracker(const DirectTracker&) = delete;
  DirectTracker& operator=(const DirectTracker&) = delete;

  /// As Tracker::set_keyframe(). With SitePlane the motion is planar and its covariance says what a
  /// plane cannot know.
  [[nodiscard]] TrackingReason set_keyframe(const cv::Mat& image, const SiteGeometry& geometry,
                                            const cv::Mat& mask = {});

  /// Estimates the motion of the site from the keyframe to `image` (CV_8UC1 or BGR CV_8UC3).
  /// `t_exposure` must be later than at every call before; otherwise the frame is lost and nothing
  /// else happens. One thread at a time. While it follows, no memory is taken; the check of the
  /// features (unless it has its own thread) and the search after a jolt take some and give it
  /// back: nothing grows.
  [[nodiscard]] MotionEstimate track(const cv::Mat& image, std::chrono::nanoseconds t_exposure);

  /// Where the patches with a say in the newest estimate are now, camera, mm: as many as there is
  /// room for (512 hold all). How many that are: 0 when it is lost, or changed after the patches
  /// were asked. For display. Takes no memory; the thread of track().
  [[nodiscard]] std::size_t inliers(std::span<Eigen::Vector3d> p_camera_mm) const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace holdfast::perception
