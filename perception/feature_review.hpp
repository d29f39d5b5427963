// SPDX-License-Identifier: Apache-2.0
// What the features have to say of directly aligned poses: when they are asked, on which thread,
// and what they object. An objection stands until a later check is content.
#pragma once

#include <memory>
#include <optional>

#include "perception/check_thread.hpp"
#include "perception/feature_check.hpp"

namespace holdfast::perception {

/// Belongs to one keyframe. One thread at a time.
class FeatureReview {
 public:
  FeatureReview(const CameraModel& camera, const TrackerParameters& parameters);

  /// Once. Refuses a keyframe that is not found again in itself, as a pattern that repeats: it
  /// proves no pose.
  /// `moving_half`: as FeatureCheck's.
  [[nodiscard]] TrackingReason set_keyframe(const cv::Mat& image, const Site& site,
                                            const cv::Mat& mask, const cv::Mat& moving_half = {});

  /// The site, wherever it is; counts as this frame's check once it is judged.
  [[nodiscard]] FeatureMotion find(const cv::Mat& image);
  /// The check to judge at this frame: of this frame, made at once when it `is_urgent` or there is
  /// no second thread; or of an earlier one that the second thread has finished with. Orders the
  /// next.
  [[nodiscard]] std::optional<CheckResult> next(const cv::Mat& image, const CheckedPose& pose,
                                                bool is_urgent);
  /// Compares, notes the difference in `out`, and keeps what the features object.
  void judge(const FeatureMotion& motion, const CheckedPose& of, MotionEstimate& out);
  [[nodiscard]] TrackingReason objection() const noexcept { return objection_; }

 private:
  [[nodiscard]] TrackingReason objection_to(const FeatureMotion& motion, const CheckedPose& of,
                                            MotionEstimate& out);
  CameraModel camera_;
  TrackerParameters parameters_;
  Eigen::Vector3d p_pivot_mm_ = Eigen::Vector3d::Zero();
  FeatureCheck features_;
  std::unique_ptr<CheckThread> checker_;  // none: checks are made at once
  int frames_since_check_, checks_failed_ = 0;
  TrackingReason objection_ = TrackingReason::none;
};

}  // namespace holdfast::perception
