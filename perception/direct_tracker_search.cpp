// SPDX-License-Identifier: Apache-2.0
// DirectTracker: how the site is found again, after a jolt, after a loss, behind what is fixed to
// the camera.
#include <optional>

#include "perception/direct_tracker_impl.hpp"
#include "perception/stage_timer.hpp"
#include "perception/tracker_rules.hpp"

namespace holdfast::perception {

void DirectTracker::Impl::forget_motion() {
  T_newest.reset();
  T_before.reset();
  shift.forget();
  if (key != nullptr) key->chain.break_off();
}

/// The first keyframe is where the search begins.
void DirectTracker::Impl::lose(MotionEstimate& out) {
  out.status = TrackingStatus::lost;
  forget_motion();
  use(nullptr);
}

/// After a jolt: the frame before, shifted as the picture is.
std::optional<Eigen::Isometry3d> DirectTracker::Impl::recalled() {
  const auto moved_px = shift.find(pyramid.levels[kCoarsest]);
  if (!moved_px) return std::nullopt;
  const double z_mm = (*T_newest * key->given.site.p_pivot_mm()).z();
  return Eigen::Translation3d(moved_px->x / camera.fx_px * z_mm, moved_px->y / camera.fy_px * z_mm,
                              0) *
         *T_newest;
}

/// From nothing: the features find the site, alignment makes it exact and must agree.
bool DirectTracker::Impl::relocalise(const cv::Mat& image, MotionEstimate& out) {
  const StageTimer timer(out.times.check);
  const FeatureMotion found = key->features.find(image);
  out.features = found.features;
  out.matches = found.matches;
  out.reason = found.reason;
  if (!found.fit) return false;
  const Eigen::Isometry3d& T_found = found.fit->pose.T_camera_site;
  if (!accept(key->aligner.align(key->patches, pyramid, T_found, 1), out)) return false;
  if (displacement_um(T_found, out.T_camera_site, key->given.site.p_pivot_mm()) >
      parameters.check.limit_um) {
    out.reason = TrackingReason::check_disagreement;
    return false;
  }
  key->features.judge(found, {out.T_camera_site, out.covariance}, out);
  return true;
}

/// By the keyframe in use, by the first, and by one of the tied, a different one at every frame.
bool DirectTracker::Impl::relocalise_by_any(const cv::Mat& image, MotionEstimate& out) {
  if (relocalise(image, out)) return true;
  TiedKeyframe* other = ties.current() != nullptr ? nullptr : ties.to_look_for();
  if (other == nullptr && ties.current() == nullptr) return false;
  const TrackingReason reason = out.reason;
  forget_motion();
  use(other);
  if (relocalise(image, out)) return true;
  out.reason = reason;
  return false;
}

/// Takes what has not changed for fixed to the camera, and looks for the site without it.
bool DirectTracker::Impl::learn_fixed(const cv::Mat& image, MotionEstimate& out) {
  constexpr int kPause = 10;  // frames; what moved little is told apart better later
  if (frames_since_learning++ % kPause != 0) return false;
  const GivenKeyframe given = key->given;
  const Eigen::Isometry3d T_fixed = out.T_camera_site;
  if (take_keyframe(given, key->stillness.moving_half(pyramid)) != TrackingReason::none)
    return false;
  // Noticed soon, the site is still near; and between dots there is no room for features.
  return (accept(key->aligner.align(key->patches, pyramid, T_fixed, kCoarsest), out) ||
          relocalise(image, out)) &&
         !is_contradicted(out);
}

}  // namespace holdfast::perception
