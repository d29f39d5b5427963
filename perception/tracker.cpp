// SPDX-License-Identifier: Apache-2.0
#include "perception/tracker.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <stdexcept>

#include "perception/motion_fit.hpp"
#include "perception/stage_timer.hpp"
#include "perception/tracker_parameters.hpp"

namespace holdfast::perception {
namespace {

using Clock = std::chrono::steady_clock;

Eigen::Vector3d unknown_point() {
  return Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
}

Eigen::Vector2d project(const Eigen::Vector3d& p) {
  return p.head<2>() / p.z();
}

void keep_where(Features& features, const std::vector<bool>& keep) {
  std::size_t n = 0;
  for (std::size_t i = 0; i < keep.size(); ++i) {
    if (!keep[i]) continue;
    features.pixels[n] = features.pixels[i];
    features.descriptors[n] = features.descriptors[i];
    features.strengths[n++] = features.strengths[i];
  }
  features.pixels.resize(n);
  features.descriptors.resize(n);
  features.strengths.resize(n);
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

  Impl(const CameraModel& c, const TrackerParameters& p)
      : camera(c), parameters(p), detector(p.features) {
    camera.distortion = c.distortion.clone();
  }

  [[nodiscard]] TrackingReason unusable(const cv::Mat& image) const;
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

TrackingReason Tracker::Impl::unusable(const cv::Mat& image) const {
  if (image.cols != camera.width_px || image.rows != camera.height_px || image.dims != 2)
    return TrackingReason::wrong_image_size;
  if (image.type() != CV_8UC1 && image.type() != CV_8UC3) return TrackingReason::wrong_image_type;
  return TrackingReason::none;
}

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
  const Eigen::Isometry3d& T = fit.pose.T_camera_site;
  out.T_camera_site = T;
  out.covariance = fit.covariance;
  out.p_pivot_site_mm = site.p_pivot_mm();
  const Eigen::Vector3d p = site.p_centre_mm(), q = T * p;
  const Eigen::Vector2d moved_um = 1000 * p.z() * (project(q) - project(p));
  out.dx_um = moved_um.x();
  out.dy_um = moved_um.y();
  const Eigen::Matrix3d R = T.linear();
  out.rotation_rad = std::atan2(R(1, 0) - R(0, 1), R(0, 0) + R(1, 1));
  out.scale = p.z() / q.z();
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
  const Eigen::Vector3d p_chain = *T_chain * site.p_pivot_mm();
  const Eigen::Vector3d p_anchored = out.T_camera_site * site.p_pivot_mm();
  const double drift_um = 1000 * p_anchored.z() * (project(p_chain) - project(p_anchored)).norm();
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
  if (const auto what = invalid_camera(camera)) throw std::invalid_argument("camera: " + *what);
  if (const auto what = invalid_parameter(parameters))
    throw std::invalid_argument("tracker parameter " + *what);
}
Tracker::~Tracker() = default;
Tracker::Tracker(Tracker&&) noexcept = default;
Tracker& Tracker::operator=(Tracker&&) noexcept = default;

TrackingReason Tracker::set_keyframe(const cv::Mat& image, const SiteGeometry& geometry,
                                     const cv::Mat& mask) {
  Impl& s = *impl_;
  if (const TrackingReason reason = s.unusable(image); reason != TrackingReason::none)
    return reason;
  if (!mask.empty() && mask.size() != image.size()) return TrackingReason::wrong_image_size;
  if (!mask.empty() && mask.type() != CV_8UC1) return TrackingReason::wrong_image_type;
  if (invalid_geometry(s.camera, geometry)) return TrackingReason::invalid_geometry;

  const Site site(s.camera, geometry);
  View view;
  make_grey_and_mask(image, s.parameters.mask, view.images);
  constexpr int kSettling = 12;
  s.detector.reset();
  for (int i = 0; i < kSettling; ++i)
    s.detector.detect(view.images.grey, view.images.half, view.images.keep_half, view.features);
  const std::vector<cv::Point2d> pixels(view.features.pixels.begin(), view.features.pixels.end());
  const auto rays = to_normalised(s.camera, pixels);
  std::vector<bool> keep(pixels.size());
  std::vector<Eigen::Vector3d> p_site_mm;
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    const auto point = site.lift({rays[i].x, rays[i].y});
    keep[i] = point.has_value() && (mask.empty() || mask.at<uchar>(cv::Point(pixels[i])) != 0);
    if (keep[i]) p_site_mm.push_back(*point);
  }
  keep_where(view.features, keep);
  if (view.features.size() < s.parameters.health.features_min)
    return TrackingReason::too_few_features;

  s.site = site;
  s.keyframe = std::move(view);
  s.p_keyframe_mm = std::move(p_site_mm);
  s.has_keyframe = true;
  s.was_lost = false;
  s.forget_motion();
  return TrackingReason::none;
}

MotionEstimate Tracker::track(const cv::Mat& image, std::chrono::nanoseconds t_exposure) {
  Impl& s = *impl_;
  MotionEstimate out;
  out.t_exposure = t_exposure;
  const Clock::time_point start = Clock::now();
  if (s.has_keyframe) out.reason = s.unusable(image);
  if (out.reason == TrackingReason::none) {
    {
      const StageTimer timer(out.times.mask);
      make_grey_and_mask(image, s.parameters.mask, s.current.images);
    }
    s.estimate(out);
    s.finish(out);
  } else {
    s.forget_motion();
    s.was_lost = s.has_keyframe;
  }
  if (out.status == TrackingStatus::lost) {  // no number of a lost frame may be mistaken for a pose
    const MotionEstimate evidence = out;
    out = MotionEstimate{};
    out.reason = evidence.reason;
    out.t_exposure = t_exposure;
    out.features = evidence.features;
    out.matches = evidence.matches;
    out.times = evidence.times;
  }
  out.times.total = Clock::now() - start;
  return out;
}

}  // namespace holdfast::perception
