// SPDX-License-Identifier: Apache-2.0
// DirectTracker: what becomes of keyframes tied to the first.
#include <optional>
#include <utility>

#include "perception/direct_tracker_impl.hpp"
#include "perception/stage_timer.hpp"
#include "perception/tracker_rules.hpp"

namespace holdfast::perception {

/// Another keyframe from here on (none: the first): what is known of the motion is told since it.
void DirectTracker::Impl::use(TiedKeyframe* next) {
  DirectKeyframe& to = next != nullptr ? next->key : *first;
  if (&to == key) return;
  const TiedKeyframe* before = ties.current();
  Eigen::Isometry3d T_to_key = Eigen::Isometry3d::Identity();
  if (next != nullptr) T_to_key = next->tie.T_tied_first;
  if (before != nullptr) T_to_key = T_to_key * before->tie.T_tied_first.inverse(Eigen::Isometry);
  const Eigen::Isometry3d T_key_to = T_to_key.inverse(Eigen::Isometry);
  if (T_newest) *T_newest = *T_newest * T_key_to;
  if (T_before) *T_before = *T_before * T_key_to;
  has_inliers = false;
  std::swap(key->chain, to.chain);
  to.chain.rebase(T_to_key);
  key = &to;
  ties.use(next);
}

/// In the frame of the keyframe in use.
Eigen::Vector3d DirectTracker::Impl::p_pivot_of_first() const {
  const Eigen::Vector3d& p_first = first->given.site.p_pivot_mm();
  return ties.current() != nullptr ? ties.current()->tie.T_tied_first * p_first : p_first;
}

/// The pose since the first keyframe, if another is in use; and which is to be used from now on.
void DirectTracker::Impl::tend_ties(const cv::Mat& image, MotionEstimate& out) {
  const StageTimer timer(out.times.ties);
  const auto degrade = [&] {
    out.status = TrackingStatus::degraded;
    out.reason = TrackingReason::tie_doubtful;
  };
  const TieVerdict verdict = ties.tend(*first, image, pyramid, out);
  if (ties.current() != nullptr) {
    const CheckedPose pose = ties.since_first(*first, {out.T_camera_site, out.covariance});
    set_pose(pose.T_camera_site, pose.covariance, first->given.site, out);
    out.keyframe = ties.current()->number;
  }
  if (verdict.is_loose) degrade();
  switch (verdict.change) {
    case TieVerdict::Change::none:
      return;
    case TieVerdict::Change::to_first:
      return use(nullptr);
    case TieVerdict::Change::to_tied:
      return use(verdict.next);
    case TieVerdict::Change::doubted:
      break;
  }
  use(nullptr);
  ties.drop_all();
  degrade();
  if (verdict.of_first.is_solved) {
    fill(verdict.of_first, out);
    has_inliers = false;  // the first's aligner may have been asked more since
    out.keyframe = 0;
    T_newest = out.T_camera_site;
    T_before.reset();
  } else {
    out.status = TrackingStatus::lost;  // where the site is, only the features of the first know
  }
}

}  // namespace holdfast::perception
