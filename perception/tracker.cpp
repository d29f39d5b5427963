// SPDX-License-Identifier: Apache-2.0
#include "perception/tracker.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "perception/keyframe_view.hpp"
#include "perception/motion_fit.hpp"
#include "perception/stage_timer.hpp"
#include "perception/tracker_parameters.hpp"
#include "perception/tracker_rules.hpp"

namespace holdfast::perception {
namespace {

using Clock = std::chrono::steady_clock;

Eigen::Vector3d unknown_point() {
  return Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
}

}  // namespace

struct Tracker::Impl {
  CameraModel camera;
  TrackerParameters parameters;
  FeatureDetector detector;

  // The keyframe
  bool has_keyframe = false;
  Site site;
  View keyframe;
  std::vector<Eigen::Vector3d> p_keyframe_mm;

  // From frame to frame
  View current, previous;
  bool has_previous = false;
  std::optional<Eigen::Isometry3d> T_anchored, T_anchored_before;  // newest and the one before
  std::optional<Eigen::Isometry3d> T_chain;
  int chain_length = 0;
  cv::Point2d flow_px;  // of the pivot, from the frame before to the newest
  bool was_lost = false;
  std::optional<std::chrono::nanoseconds> t_newest;

  Impl(const CameraModel& c, const TrackerParameters& p)
      : camera(c), parameters(p), detector(p.features) {
    camera.distortion = c.distortion.clone();
  }

  [[nodiscard]] Eigen::Isometry3d predicted() const;
  [[nodiscard]] MotionResult anchor(bool use_prediction, MotionEstimate& out) const;
  void judge(const MotionFit& fit, MotionEstimate& out) const;
  void fill(const MotionFit& fit, MotionEstimate& out) const;
  [[nodiscard]] std::optional<Eigen::Isometry3d> frame_to_frame(MotionEstimate& out);
  void check_drift(const std::optional<Eigen::Isometry3d>& T_chained, MotionEstimate& out);
  void estimate(MotionEstimate& out);
  void finish(const MotionEstimate& out);
  void forget_motion();
};

void Tracker::Impl::forget_motion() {
  has_previous = false;
  T_anchored.reset();
  T_anchored_before.reset();
  T_chain.reset();
  chain_length = 0;
  flow_px = {};
}

/// Constant velocity from frame to frame.
Eigen::Isometry3d Tracker::Impl::predicted() const {
  if (!T_anchored_before) return *T_anchored;
  return *T_anchored * T_anchored_before->inverse(Eigen::Isometry) * *T_anchored;
}

MotionResult Tracker::Impl::anchor(bool use_prediction, MotionEstimate& out) const {
  std::vector<Match> matches;
  {
    const StageTimer timer(out.times.match);
    if (use_prediction) {
      const Eigen::Isometry3d T = predicted();
      std::vector<cv::Point2d> rays;
      for (const Eigen::Vector3d& p_site : p_keyframe_mm) {
        const Eigen::Vector2d ray = project(T * p_site);
        rays.emplace_back(ray.x(), ray.y());
      }
      matches = match_near(keyframe.features, to_pixels(camera, rays), current.features,
                           parameters.match);
    } else {
      matches = match_all(keyframe.features, current.features, parameters.match);
    }
  }
  out.matches = static_cast<int>(matches.size());
  const StageTimer timer(out.times.model);
  return fit_motion({camera, parameters, site, keyframe, p_keyframe_mm,
                     Eigen::Isometry3d::Identity(), current, matches});
}

/// Sets status and reason from the evidence; `tracking` unless something speaks against it.
void Tracker::Impl::judge(const MotionFit& fit, MotionEstimate& out) const {
  const HealthParameters& health = parameters.health;
  const auto inliers = static_cast<int>(fit.pose.inliers.size());
  const double share = static_cast<double>(fit.coarse_inliers) / std::max(out.matches, 1);
  const double rival = static_cast<double>(fit.rival_inliers) / std::max(fit.coarse_inliers, 1);
  const double angle = Eigen::AngleAxisd(fit.pose.T_camera_site.linear()).angle();
  const auto set = [&](TrackingStatus status, TrackingReason reason) {
    out.status = status;
    out.reason = reason;
  };
  if (!(std::abs(out.scale - 1) <= health.scale_change_max && angle <= health.rotation_max_rad))
    return set(TrackingStatus::lost, TrackingReason::implausible_motion);
  if (share < health.inlier_share_min || rival >= health.rival_share_lost ||
      !fit.covariance.allFinite())
    return set(TrackingStatus::lost, TrackingReason::inconsistent_motion);
  if (fit.spread < health.spread_min)
    return set(TrackingStatus::lost, TrackingReason::inliers_bunched);
  if (inliers < health.inliers_good)
    return set(TrackingStatus::degraded, TrackingReason::too_few_inliers);
  if (share < health.inlier_share_good || rival >= health.rival_share_min ||
      fit.pose.rms_px > health.rms_good_px)
    return set(TrackingStatus::degraded, TrackingReason::inconsistent_motion);
  if (fit.spread < health.spread_good)
    return set(TrackingStatus::degraded, TrackingReason::inliers_bunched);
  set(was_lost ? TrackingStatus::relocalised : TrackingStatus::tracking, TrackingReason::none);
}

void Tracker::Impl::fill(const MotionFit& fit, MotionEstimate& out) const {
  set_pose(fit.pose.T_camera_site, fit.covariance, site, out);
  out.inliers = static_cast<int>(fit.pose.inliers.size());
  out.inlier_spread = fit.spread;
  out.reprojection_rms_px = fit.pose.rms_px;
}

/// The pose of the current frame from the previous frame alone: that one's features, placed on the
/// site by the chain's own pose. Nothing when there is no such frame or no agreement.
std::optional<Eigen::Isometry3d> Tracker::Impl::frame_to_frame(MotionEstimate& out) {
  if (!has_previous) return std::nullopt;
  if (!T_chain) {  // a new chain starts at the newest pose
    T_chain = T_anchored;
    chain_length = 0;
  }
  if (!T_chain) return std::nullopt;
  std::vector<Match> matches;
  {
    const StageTimer timer(out.times.match);
    std::vector<cv::Point2d> places;
    for (const cv::Point2f& pixel : previous.features.pixels)
      places.push_back(cv::Point2d(pixel) + flow_px);
    matches = match_near(previous.features, places, current.features, parameters.match);
    if (static_cast<int>(matches.size()) < 4 * parameters.health.inliers_min)
      matches = match_all(previous.features, current.features, parameters.match);
  }
  const StageTimer timer(out.times.model);
  std::vector<cv::Point2d> pixels;
  pixels.reserve(matches.size());
  for (const Match& match : matches)
    pixels.emplace_back(previous.features.pixels[static_cast<std::size_t>(match.first)]);
  const auto rays = to_normalised(camera, pixels);
  std::vector<Eigen::Vector3d> p_site_mm(previous.features.pixels.size(), unknown_point());
  for (std::size_t i = 0; i < matches.size(); ++i)
    p_site_mm[static_cast<std::size_t>(matches[i].first)] =
        site.meet({rays[i].x, rays[i].y}, *T_chain).value_or(unknown_point());
  const MotionResult result =
      fit_motion({camera, parameters, site, previous, p_site_mm, *T_chain, current, matches});
  if (!result.fit) return std::nullopt;
  const MotionFit& fit = *result.fit;
  const double share =
      static_cast<double>(fit.coarse_inliers) / std::max<double>(1, double(matches.size()));
  if (share < parameters.health.inlier_share_min || fit.spread < parameters.health.spread_min)
    return std::nullopt;
  const Eigen::Vector3d before = *T_chain * site.p_pivot_mm();
  const Eigen::Vector3d now = fit.pose.T_camera_site * site.p_pivot_mm();
  const Eigen::Vector2d flow = project(now) - project(before);
  out.frame_to_frame_dx_um = 1000 * before.z() * flow.x();
  out.frame_to_frame_dy_um = 1000 * before.z() * flow.y();
  out.has_frame_to_frame = true;
  flow_px = {camera.fx_px * flow.x(), camera.fy_px * flow.y()};
  return fit.pose.T_camera_site;
}

/// Compares the chain with the keyframe. When they part, the keyframe is searched anew without any
/// prediction: if that confirms the anchored pose, the chain was wrong and starts anew (this frame
/// is degraded); otherwise nothing is known and the frame is lost.
void Tracker::Impl::check_drift(const std::optional<Eigen::Isometry3d>& T_chained,
                                MotionEstimate& out) {
  if (!T_chained) {
    T_chain.reset();
    return;
  }
  T_chain = T_chained;
  ++chain_length;
  if (out.status == TrackingStatus::lost) return;
  const Eigen::Vector3d p_anchored = out.T_camera_site * site.p_pivot_mm();
  const double drift_um = displacement_um(out.T_camera_site, *T_chain, site.p_pivot_mm());
  out.has_drift = true;
  out.drift_um = drift_um;
  const double limit_um = parameters.health.drift_good_um;
  if (drift_um <= limit_um) {
    if (chain_length >= parameters.health.chain_length_max && drift_um <= limit_um / 2)
      T_chain.reset();  // starts anew from this frame's anchored pose
    return;
  }
  const MotionResult again = anchor(false, out);
  const bool is_confirmed =
      again.fit &&
      1000 * (again.fit->pose.T_camera_site * site.p_pivot_mm() - p_anchored).head<2>().norm() <
          limit_um / 2;
  out.status = is_confirmed ? TrackingStatus::degraded : TrackingStatus::lost;
  out.reason = TrackingReason::drift_disagreement;
  T_chain.reset();
}

void Tracker::Impl::estimate(MotionEstimate& out) {
  {
    const StageTimer timer(out.times.detect);
    detector.detect(current.images.grey, current.images.half, current.images.keep_half,
                    current.features);
  }
  out.features = current.features.size();
  out.reason = TrackingReason::too_few_features;
  if (out.features < parameters.health.features_min) return;

  const auto attempt = [&](bool use_prediction) {
    const MotionResult result = anchor(use_prediction, out);
    out.status = TrackingStatus::lost;
    out.reason = result.reason;
    if (!result.fit) return;
    fill(*result.fit, out);
    judge(*result.fit, out);
  };
  if (T_anchored) attempt(true);
  if (out.status == TrackingStatus::lost) attempt(false);
  check_drift(frame_to_frame(out), out);
}

/// Hands the state on to the next frame.
void Tracker::Impl::finish(const MotionEstimate& out) {
  const bool is_lost = out.status == TrackingStatus::lost;
  if (is_lost) {
    T_anchored.reset();
    T_anchored_before.reset();
    was_lost = true;
  } else {
    T_anchored_before = T_anchored;
    T_anchored = out.T_camera_site;
    if (out.status != TrackingStatus::degraded) was_lost = false;
  }
  has_previous = out.features >= parameters.health.features_min;
  if (!has_previous) T_chain.reset();
  std::swap(previous, current);
}

Tracker::Tracker(const CameraModel& camera, const TrackerParameters& parameters)
    : impl_(std::make_unique<Impl>(camera, parameters)) {
  require_valid(camera, parameters);
}
Tracker::~Tracker() = default;
Tracker::Tracker(Tracker&&) noexcept = default;
Tracker& Tracker::operator=(Tracker&&) noexcept = default;

TrackingReason Tracker::set_keyframe(const cv::Mat& image, const SiteGeometry& geometry,
                                     const cv::Mat& mask) {
  Impl& s = *impl_;
  if (const auto reason = unusable_keyframe(s.camera, image, geometry, mask);
      reason != TrackingReason::none)
    return reason;

  const Site site(s.camera, geometry);
  auto seen = see_keyframe(image, site, mask, {}, s.camera, s.parameters, s.detector);
  if (!seen) return TrackingReason::too_few_features;
  s.site = site;
  s.keyframe = std::move(seen->view);
  s.p_keyframe_mm = std::move(seen->p_site_mm);
  s.has_keyframe = true;
  s.was_lost = false;
  s.t_newest.reset();
  s.forget_motion();
  return TrackingReason::none;
}

MotionEstimate Tracker::track(const cv::Mat& image, std::chrono::nanoseconds t_exposure) {
  Impl& s = *impl_;
  MotionEstimate out;
  out.t_exposure = t_exposure;
  const Clock::time_point start = Clock::now();
  if (s.has_keyframe) out.reason = unusable_image(s.camera, image);
  if (out.reason == TrackingReason::none && s.t_newest && t_exposure <= *s.t_newest)
    out.reason = TrackingReason::time_not_increasing;
  if (out.reason == TrackingReason::none) {
    s.t_newest = t_exposure;
    {
      const StageTimer timer(out.times.mask);
      make_grey_and_mask(image, s.parameters.mask, s.current.images);
    }
    s.estimate(out);
    s.finish(out);
  } else if (out.reason != TrackingReason::time_not_increasing) {
    s.forget_motion();
    s.was_lost = s.has_keyframe;
  }
  if (out.status == TrackingStatus::lost) out = without_pose(out);
  out.times.total = Clock::now() - start;
  return out;
}

}  // namespace holdfast::perception
