// SPDX-License-Identifier: Apache-2.0
#include "perception/direct_tracker.hpp"

#include <algorithm>
#include <cmath>
#include <optional>

#include "perception/direct_tracker_impl.hpp"
#include "perception/stage_timer.hpp"
#include "perception/tracker_rules.hpp"

namespace holdfast::perception {

/// Constant velocity or none, whichever the image resembles more.
Eigen::Isometry3d DirectTracker::Impl::predicted() {
  Eigen::Isometry3d best = *T_newest;
  if (!T_before) return best;
  const Eigen::Isometry3d moving = *T_newest * T_before->inverse(Eigen::Isometry) * *T_newest;
  const double still = key->aligner.similarity(key->patches, pyramid, kCoarsest, *T_newest);
  if (key->aligner.similarity(key->patches, pyramid, kCoarsest, moving) > still) best = moving;
  return best;
}

/// Why an alignment is no pose; none when it may be one.
TrackingReason DirectTracker::Impl::unsound(const Alignment& a) const {
  const DirectParameters& p = parameters.direct;
  if (!a.is_solved || a.quality.inliers < p.inliers_min) return TrackingReason::too_few_inliers;
  const Eigen::Isometry3d& T = a.T_camera_site;
  const double scale = key->given.site.p_centre_mm().z() / (T * key->given.site.p_centre_mm()).z();
  if (!(std::abs(scale - 1) <= parameters.health.scale_change_max &&
        Eigen::AngleAxisd(T.linear()).angle() <= parameters.health.rotation_max_rad))
    return TrackingReason::implausible_motion;
  if (a.quality.inliers < p.share_min * a.quality.visible)
    return TrackingReason::inconsistent_motion;
  if (a.quality.spread < parameters.health.spread_min) return TrackingReason::inliers_bunched;
  return TrackingReason::none;
}

/// Of the newest alignment by the keyframe in use.
void DirectTracker::Impl::fill(const Alignment& a, MotionEstimate& out) {
  has_inliers = true;
  set_pose(a.T_camera_site, a.covariance, key->given.site, out);
  out.features = static_cast<int>(key->patches[0].size());
  out.matches = a.quality.visible;
  out.inliers = a.quality.inliers;
  out.inlier_spread = a.quality.spread;
  out.reprojection_rms_px = a.quality.residual_px;
  out.zncc = a.quality.zncc;
  out.brightness = a.quality.brightness;
  out.contrast = a.quality.contrast;
  out.noise_grey = a.quality.noise;
}

/// Takes the alignment as this frame's pose unless something speaks against any pose.
bool DirectTracker::Impl::accept(const Alignment& a, MotionEstimate& out) {
  out.reason = unsound(a);
  if (out.reason != TrackingReason::none) return false;
  fill(a, out);
  const auto degrade = [&](TrackingReason reason) {
    out.status = TrackingStatus::degraded;
    out.reason = reason;
  };
  out.status = TrackingStatus::tracking;
  if (a.quality.inliers < parameters.direct.inliers_good)
    degrade(TrackingReason::too_few_inliers);
  else if (a.quality.inliers < parameters.direct.share_good * a.quality.visible)
    degrade(TrackingReason::inconsistent_motion);
  else if (a.quality.spread < parameters.health.spread_good)
    degrade(TrackingReason::inliers_bunched);
  // Blur moves the edges of what is curved: all patches may then agree on a wrong pose.
  const double sharpness = std::max(a.quality.sharpness, 1e-3);
  if (std::max(sharpness, 1 / sharpness) > parameters.direct.sharpness_ratio_good)
    degrade(TrackingReason::out_of_focus);
  // The strongest texture may be fixed to the microscope: the weak one must have moved with it.
  constexpr int kWitnessesMin = 12;
  const Testimony testimony = key->aligner.ask(key->witnesses, pyramid, a.T_camera_site);
  if (testimony.visible >= kWitnessesMin &&
      testimony.agreeing < parameters.direct.witness_share_good * testimony.visible)
    degrade(TrackingReason::inconsistent_motion);
  return true;
}

/// From the frame before to this one.
bool DirectTracker::Impl::follow(MotionEstimate& out) {
  const StageTimer timer(out.times.align);
  Eigen::Isometry3d T_start = predicted();
  bool has_recalled = false;
  const auto recall = [&] {
    has_recalled = true;
    const auto T = recalled();
    if (T && key->aligner.similarity(key->patches, pyramid, kCoarsest, *T) >
                 key->aligner.similarity(key->patches, pyramid, kCoarsest, T_start)) {
      T_start = *T;
      return true;
    }
    return false;
  };
  if (key->aligner.similarity(key->patches, pyramid, kCoarsest, T_start) <
      parameters.direct.recall_zncc)
    (void)recall();
  if (accept(key->aligner.align(key->patches, pyramid, T_start, kCoarsest), out)) return true;
  return !has_recalled && recall() &&
         accept(key->aligner.align(key->patches, pyramid, T_start, kCoarsest), out);
}

/// Follows the chain to this frame and compares. A chain that broke says nothing; one that
/// disagrees leaves it to the features.
void DirectTracker::Impl::compare_chain(MotionEstimate& out) {
  const StageTimer timer(out.times.chain);
  FrameChain& chain = key->chain;
  std::optional<Eigen::Isometry3d> T_chained;
  if (chain.is_linked() && T_newest) {
    const Eigen::Isometry3d T_step = out.T_camera_site * T_newest->inverse(Eigen::Isometry);
    T_chained = chain.follow(pyramid, T_step * chain.T_last());
    if (!T_chained) T_chained = chain.follow(pyramid, chain.T_last());
  }
  if (T_chained) {
    const Eigen::Vector3d before = chain.T_last() * key->given.site.p_pivot_mm();
    const Eigen::Vector2d flow =
        project(*T_chained * key->given.site.p_pivot_mm()) - project(before);
    out.has_frame_to_frame = true;
    out.frame_to_frame_dx_um = 1000 * before.z() * flow.x();
    out.frame_to_frame_dy_um = 1000 * before.z() * flow.y();
    out.has_drift = true;
    out.drift_um = displacement_um(out.T_camera_site, *T_chained, p_pivot_of_first());
  }
  const bool agrees = T_chained && out.drift_um <= parameters.health.drift_good_um / 2;
  const bool goes_on = agrees && chain.length() < parameters.health.chain_length_max;
  chain.link(pyramid, key->patches, goes_on ? *T_chained : out.T_camera_site, !goes_on);
}

void DirectTracker::Impl::object(MotionEstimate& out) const {
  const TrackingReason objection = key->features.objection();
  if (objection == TrackingReason::none || out.status == TrackingStatus::lost) return;
  out.status = TrackingStatus::degraded;
  out.reason = objection;
}

/// What the features contradict is replaced by their pose when alignment from there explains more
/// of the image. An objection stands until a check is content.
void DirectTracker::Impl::compare_features(const cv::Mat& image, MotionEstimate& out) {
  const StageTimer timer(out.times.check);
  const bool has_drifted = out.has_drift && out.drift_um > parameters.health.drift_good_um;
  const auto check = key->features.next(image, {out.T_camera_site, out.covariance}, has_drifted);
  if (!check) return;
  const FeatureMotion& found = check->motion;
  key->features.judge(found, check->of, out);
  if (has_drifted) {
    out.status = found.fit ? TrackingStatus::degraded : TrackingStatus::lost;  // nobody knows
    out.reason = TrackingReason::drift_disagreement;
    if (!found.fit) return;
  }
  if (key->features.objection() != TrackingReason::check_disagreement) return;
  has_inliers = false;  // unless the other is better
  const Eigen::Isometry3d T_since =
      out.T_camera_site * check->of.T_camera_site.inverse(Eigen::Isometry);
  const Alignment other =
      key->aligner.align(key->patches, pyramid, T_since * found.fit->pose.T_camera_site, 1);
  if (unsound(other) == TrackingReason::none && other.quality.inliers > out.inliers) {
    fill(other, out);
    key->chain.break_off();
  }
}

bool DirectTracker::Impl::is_contradicted(const MotionEstimate& out) const {
  return key->stillness.contradicts(out.T_camera_site, pyramid, out.noise_grey);
}

void DirectTracker::Impl::estimate(const cv::Mat& image, MotionEstimate& out) {
  {
    const StageTimer timer(out.times.pyramid);
    make_pyramid(image, pyramid);
  }
  bool is_followed = T_newest && follow(out);
  bool is_found = is_followed || relocalise_by_any(image, out);
  if (is_found && is_contradicted(out)) {
    is_followed = false;
    is_found = ties.current() == nullptr && learn_fixed(image, out);
    if (!is_found) out.reason = TrackingReason::fixed_pattern;
  } else if (is_found) {
    frames_since_learning = 0;
  }
  if (!is_found) return lose(out);
  if (!is_followed) {
    if (out.status == TrackingStatus::tracking) out.status = TrackingStatus::relocalised;
    T_newest.reset();
    key->chain.break_off();
  }
  compare_chain(out);
  if (is_followed) compare_features(image, out);
  object(out);
  if (out.status == TrackingStatus::lost) return lose(out);
  T_before = T_newest;
  T_newest = out.T_camera_site;
  shift.remember(pyramid.levels[kCoarsest]);
  tend_ties(image, out);
  if (out.status == TrackingStatus::lost) lose(out);
}

/// The former keyframe stays when this one cannot serve.
TrackingReason DirectTracker::Impl::take_keyframe(const GivenKeyframe& given,
                                                  const cv::Mat& moving_half) {
  DirectKeyframeResult made = make_direct_keyframe(given, moving_half, camera, parameters);
  if (!made.keyframe) return made.reason;
  first.emplace(std::move(*made.keyframe));
  key = &*first;
  ties.start(moving_half);
  forget_motion();
  return TrackingReason::none;
}

DirectTracker::DirectTracker(const CameraModel& camera, const TrackerParameters& parameters)
    : impl_((require_valid(camera, parameters), std::make_unique<Impl>(camera, parameters))) {}
DirectTracker::~DirectTracker() = default;
DirectTracker::DirectTracker(DirectTracker&&) noexcept = default;
DirectTracker& DirectTracker::operator=(DirectTracker&&) noexcept = default;

TrackingReason DirectTracker::set_keyframe(const cv::Mat& image, const SiteGeometry& geometry,
                                           const cv::Mat& mask) {
  Impl& s = *impl_;
  if (const auto reason = unusable_keyframe(s.camera, image, geometry, mask);
      reason != TrackingReason::none)
    return reason;

  const GivenKeyframe given{image.clone(), Site(s.camera, geometry), mask.clone()};
  if (const auto reason = s.take_keyframe(given, {}); reason != TrackingReason::none) return reason;
  s.t_newest.reset();
  s.frames_since_learning = 0;
  s.T_newest = Eigen::Isometry3d::Identity();
  Pyramid pyramid;
  make_pyramid(image, pyramid);
  s.shift.remember(pyramid.levels[Impl::kCoarsest]);
  return TrackingReason::none;
}

std::size_t DirectTracker::inliers(std::span<Eigen::Vector3d> p_camera_mm) const noexcept {
  const Impl& s = *impl_;
  if (!s.has_inliers || !s.T_newest) return 0;
  const std::size_t count = s.key->aligner.inliers(p_camera_mm);
  for (Eigen::Vector3d& p : p_camera_mm.first(count)) p = *s.T_newest * p;
  return count;
}

MotionEstimate DirectTracker::track(const cv::Mat& image, std::chrono::nanoseconds t_exposure) {
  Impl& s = *impl_;
  MotionEstimate out;
  out.t_exposure = t_exposure;
  const auto start = std::chrono::steady_clock::now();
  s.has_inliers = false;
  if (s.key != nullptr) out.reason = unusable_image(s.camera, image);
  if (out.reason == TrackingReason::none && s.t_newest && t_exposure <= *s.t_newest)
    out.reason = TrackingReason::time_not_increasing;
  if (out.reason == TrackingReason::none) {
    s.t_newest = t_exposure;
    s.estimate(image, out);
  } else if (out.reason != TrackingReason::time_not_increasing && s.key != nullptr) {
    s.lose(out);
  }
  if (out.status == TrackingStatus::lost) out = without_pose(out);
  out.times.total = std::chrono::steady_clock::now() - start;
  return out;
}

}  // namespace holdfast::perception
