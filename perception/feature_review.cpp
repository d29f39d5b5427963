// SPDX-License-Identifier: Apache-2.0
#include "perception/feature_review.hpp"

#include <algorithm>
#include <cmath>

#include "perception/tracker_rules.hpp"

namespace holdfast::perception {

FeatureReview::FeatureReview(const CameraModel& camera, const TrackerParameters& parameters)
    : camera_(camera),
      parameters_(parameters),
      features_(camera, parameters),
      frames_since_check_(parameters.check.every_frames) {}  // the first frame is checked

TrackingReason FeatureReview::set_keyframe(const cv::Mat& image, const Site& site,
                                           const cv::Mat& mask, const cv::Mat& moving_half) {
  p_pivot_mm_ = site.p_pivot_mm();
  if (const auto reason = features_.set_keyframe(image, site, mask, moving_half);
      reason != TrackingReason::none)
    return reason;
  if (const FeatureMotion itself = features_.find(image, std::nullopt); !itself.fit)
    return itself.reason;
  if (!parameters_.check.is_threaded) return TrackingReason::none;
  FeatureCheck beside(camera_, parameters_);
  if (const auto reason = beside.set_keyframe(image, site, mask, moving_half);
      reason != TrackingReason::none)
    return reason;
  checker_ = std::make_unique<CheckThread>(std::move(beside));
  return TrackingReason::none;
}

FeatureMotion FeatureReview::find(const cv::Mat& image) {
  frames_since_check_ = 0;
  return features_.find(image, std::nullopt);
}

std::optional<CheckResult> FeatureReview::next(const cv::Mat& image, const CheckedPose& pose,
                                               bool is_urgent) {
  ++frames_since_check_;
  const int every = parameters_.check.every_frames;
  const bool is_due = every > 0 && frames_since_check_ >= every;
  if (is_urgent || (is_due && !checker_)) {
    frames_since_check_ = 0;
    return CheckResult{features_.find(image, pose.T_camera_site), pose};
  }
  if (!checker_) return std::nullopt;
  std::optional<CheckResult> result = checker_->take();
  if (is_due && checker_->order(image, pose)) frames_since_check_ = 0;
  return result;
}

void FeatureReview::judge(const FeatureMotion& motion, const CheckedPose& of, MotionEstimate& out) {
  objection_ = objection_to(motion, of, out);
}

TrackingReason FeatureReview::objection_to(const FeatureMotion& motion, const CheckedPose& of,
                                           MotionEstimate& out) {
  const CheckParameters& p = parameters_.check;
  if (motion.reason == TrackingReason::inconsistent_motion) return motion.reason;
  if (!motion.fit)
    return ++checks_failed_ > p.failures_max ? TrackingReason::unchecked : TrackingReason::none;
  checks_failed_ = 0;
  out.has_check = true;
  out.check_um = displacement_um(of.T_camera_site, motion.fit->pose.T_camera_site, p_pivot_mm_);
  const Eigen::Matrix2d C = (of.covariance + motion.fit->covariance).topLeftCorner<2, 2>();
  out.check_sigma = out.check_um * 1e-3 / std::sqrt(std::max(C.trace() / 2, 1e-12));
  if (out.check_um > p.limit_um ||
      (out.check_um > p.limit_um / 5 && out.check_sigma > p.limit_sigma))
    return TrackingReason::check_disagreement;
  if (motion.fit->rival_inliers >= parameters_.health.rival_share_min * motion.fit->coarse_inliers)
    return TrackingReason::inconsistent_motion;
  return TrackingReason::none;
}

}  // namespace holdfast::perception
