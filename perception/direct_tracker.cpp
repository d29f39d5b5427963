// SPDX-License-Identifier: Apache-2.0
#include "perception/direct_tracker.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <stdexcept>

#include <Eigen/Cholesky>

#include "perception/check_thread.hpp"
#include "perception/direct_alignment.hpp"
#include "perception/feature_check.hpp"
#include "perception/frame_chain.hpp"
#include "perception/image_shift.hpp"
#include "perception/stage_timer.hpp"
#include "perception/tracker_parameters.hpp"

namespace holdfast::perception {
namespace {

constexpr int kCoarsest = kPyramidLevels - 1;
constexpr int kPatchesMin = 40;  // of a keyframe

Eigen::Vector2d project(const Eigen::Vector3d& p) {
  return p.head<2>() / p.z();
}

/// Of a mask of the full size (0: not kept): a pixel of half size is kept when all of its four are.
cv::Mat kept_of_half(const cv::Mat& mask, cv::Size half) {
  cv::Mat kept(half, CV_8UC1);
  for (int y = 0; y < half.height; ++y) {
    const uchar *top = mask.ptr(2 * y), *bottom = mask.ptr(2 * y + 1);
    uchar* out = kept.ptr(y);
    for (int x = 0; x < half.width; ++x) {
      const bool is_kept =
          top[2 * x] != 0 && top[2 * x + 1] != 0 && bottom[2 * x] != 0 && bottom[2 * x + 1] != 0;
      out[x] = is_kept ? 255 : 0;
    }
  }
  return kept;
}

}  // namespace

struct DirectTracker::Impl {
  CameraModel camera;
  TrackerParameters parameters;

  /// What belongs to one keyframe.
  struct Keyframe {
    Site site;
    DirectTemplate patches;
    TemplateLevel witnesses;
    DirectAligner aligner;
    FrameChain chain;
    FeatureCheck features;
    std::unique_ptr<CheckThread> checker;  // none: checks are made at once
  };
  std::optional<Keyframe> key;

  Pyramid pyramid;
  ImageShift shift;
  std::optional<Eigen::Isometry3d> T_newest, T_before;  // of the last frames, if not lost
  std::optional<std::chrono::nanoseconds> t_newest;
  int frames_since_check = 0, checks_failed = 0;
  TrackingReason objection = TrackingReason::none;  // of the newest check, until one is content

  Impl(const CameraModel& c, const TrackerParameters& p) : camera(c), parameters(p) {
    camera.distortion = c.distortion.clone();
  }

  [[nodiscard]] TrackingReason unusable(const cv::Mat& image) const;
  [[nodiscard]] Eigen::Isometry3d predicted();
  [[nodiscard]] std::optional<Eigen::Isometry3d> recalled();
  [[nodiscard]] TrackingReason unsound(const Alignment& alignment) const;
  bool accept(const Alignment& alignment, MotionEstimate& out);
  bool follow(MotionEstimate& out);
  bool relocalise(const cv::Mat& image, MotionEstimate& out);
  void fill(const Alignment& alignment, MotionEstimate& out) const;
  void compare_chain(MotionEstimate& out);
  void compare_features(const cv::Mat& image, MotionEstimate& out);
  [[nodiscard]] TrackingReason judge_check(const FeatureMotion& motion, const CheckedPose& of,
                                           MotionEstimate& out);
  [[nodiscard]] std::optional<CheckResult> next_check(const cv::Mat& image, MotionEstimate& out);
  void object(MotionEstimate& out) const;
  [[nodiscard]] double difference_um(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b) const;
  void estimate(const cv::Mat& image, MotionEstimate& out);
  void forget_motion();
};

TrackingReason DirectTracker::Impl::unusable(const cv::Mat& image) const {
  if (image.dims != 2 || image.cols != camera.width_px || image.rows != camera.height_px)
    return TrackingReason::wrong_image_size;
  if (image.type() != CV_8UC1 && image.type() != CV_8UC3) return TrackingReason::wrong_image_type;
  return TrackingReason::none;
}

void DirectTracker::Impl::forget_motion() {
  T_newest.reset();
  T_before.reset();
  shift.forget();
  if (key) key->chain.break_off();
}

/// Constant velocity or none, whichever the image resembles more.
Eigen::Isometry3d DirectTracker::Impl::predicted() {
  Eigen::Isometry3d best = *T_newest;
  if (!T_before) return best;
  const Eigen::Isometry3d moving = *T_newest * T_before->inverse(Eigen::Isometry) * *T_newest;
  const double still = key->aligner.similarity(key->patches, pyramid, kCoarsest, *T_newest);
  if (key->aligner.similarity(key->patches, pyramid, kCoarsest, moving) > still) best = moving;
  return best;
}

/// After a jolt: the frame before, shifted as the picture is.
std::optional<Eigen::Isometry3d> DirectTracker::Impl::recalled() {
  const auto moved_px = shift.find(pyramid.levels[kCoarsest]);
  if (!moved_px) return std::nullopt;
  const double z_mm = (*T_newest * key->site.p_pivot_mm()).z();
  return Eigen::Translation3d(moved_px->x / camera.fx_px * z_mm, moved_px->y / camera.fy_px * z_mm,
                              0) *
         *T_newest;
}

/// Why an alignment is no pose; none when it may be one.
TrackingReason DirectTracker::Impl::unsound(const Alignment& a) const {
  const DirectParameters& p = parameters.direct;
  if (!a.is_solved || a.quality.inliers < p.inliers_min) return TrackingReason::too_few_inliers;
  const Eigen::Isometry3d& T = a.T_camera_site;
  const double scale = key->site.p_centre_mm().z() / (T * key->site.p_centre_mm()).z();
  if (!(std::abs(scale - 1) <= parameters.health.scale_change_max &&
        Eigen::AngleAxisd(T.linear()).angle() <= parameters.health.rotation_max_rad))
    return TrackingReason::implausible_motion;
  if (a.quality.inliers < p.share_min * a.quality.visible)
    return TrackingReason::inconsistent_motion;
  if (a.quality.spread < parameters.health.spread_min) return TrackingReason::inliers_bunched;
  return TrackingReason::none;
}

void DirectTracker::Impl::fill(const Alignment& a, MotionEstimate& out) const {
  const Eigen::Isometry3d& T = a.T_camera_site;
  out.T_camera_site = T;
  out.covariance = a.covariance;
  out.p_pivot_site_mm = key->site.p_pivot_mm();
  const Eigen::Vector3d p = key->site.p_centre_mm(), q = T * p;
  const Eigen::Vector2d moved_um = 1000 * p.z() * (project(q) - project(p));
  out.dx_um = moved_um.x();
  out.dy_um = moved_um.y();
  const Eigen::Matrix3d R = T.linear();
  out.rotation_rad = std::atan2(R(1, 0) - R(0, 1), R(0, 0) + R(1, 1));
  out.scale = p.z() / q.z();
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

/// From nothing: the features find the site, alignment makes it exact and must agree.
bool DirectTracker::Impl::relocalise(const cv::Mat& image, MotionEstimate& out) {
  const StageTimer timer(out.times.check);
  const FeatureMotion found = key->features.find(image, std::nullopt);
  out.features = found.features;
  out.matches = found.matches;
  out.reason = found.reason;
  if (!found.fit) return false;
  const Eigen::Isometry3d& T_found = found.fit->pose.T_camera_site;
  if (!accept(key->aligner.align(key->patches, pyramid, T_found, 1), out)) return false;
  if (difference_um(T_found, out.T_camera_site) > parameters.check.limit_um) {
    out.reason = TrackingReason::check_disagreement;
    return false;
  }
  frames_since_check = 0;
  objection = judge_check(found, {out.T_camera_site, out.covariance}, out);
  return true;
}

/// Of the pivot, in the image plane.
double DirectTracker::Impl::difference_um(const Eigen::Isometry3d& a,
                                          const Eigen::Isometry3d& b) const {
  const Eigen::Vector3d p = a * key->site.p_pivot_mm(), q = b * key->site.p_pivot_mm();
  return 1000 * p.z() * (project(p) - project(q)).norm();
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
    const Eigen::Vector3d before = chain.T_last() * key->site.p_pivot_mm();
    const Eigen::Vector2d flow = project(*T_chained * key->site.p_pivot_mm()) - project(before);
    out.has_frame_to_frame = true;
    out.frame_to_frame_dx_um = 1000 * before.z() * flow.x();
    out.frame_to_frame_dy_um = 1000 * before.z() * flow.y();
    out.has_drift = true;
    out.drift_um = difference_um(out.T_camera_site, *T_chained);
  }
  const bool agrees = T_chained && out.drift_um <= parameters.health.drift_good_um / 2;
  const bool goes_on = agrees && chain.length() < parameters.health.chain_length_max;
  chain.link(pyramid, key->patches, goes_on ? *T_chained : out.T_camera_site, !goes_on);
}

/// What the features have to object to the estimate.
TrackingReason DirectTracker::Impl::judge_check(const FeatureMotion& motion, const CheckedPose& of,
                                                MotionEstimate& out) {
  const CheckParameters& p = parameters.check;
  if (motion.reason == TrackingReason::inconsistent_motion) return motion.reason;
  if (!motion.fit)
    return ++checks_failed > p.failures_max ? TrackingReason::unchecked : TrackingReason::none;
  checks_failed = 0;
  out.has_check = true;
  out.check_um = difference_um(of.T_camera_site, motion.fit->pose.T_camera_site);
  const Eigen::Matrix2d C = (of.covariance + motion.fit->covariance).topLeftCorner<2, 2>();
  out.check_sigma = out.check_um * 1e-3 / std::sqrt(std::max(C.trace() / 2, 1e-12));
  if (out.check_um > p.limit_um ||
      (out.check_um > p.limit_um / 5 && out.check_sigma > p.limit_sigma))
    return TrackingReason::check_disagreement;
  if (motion.fit->rival_inliers >= parameters.health.rival_share_min * motion.fit->coarse_inliers)
    return TrackingReason::inconsistent_motion;
  return TrackingReason::none;
}

void DirectTracker::Impl::object(MotionEstimate& out) const {
  if (objection == TrackingReason::none || out.status == TrackingStatus::lost) return;
  out.status = TrackingStatus::degraded;
  out.reason = objection;
}

/// The check to judge at this frame: of this frame, made at once, or of an earlier one that the
/// second thread has finished with. Orders the next.
std::optional<CheckResult> DirectTracker::Impl::next_check(const cv::Mat& image,
                                                           MotionEstimate& out) {
  const CheckedPose pose{out.T_camera_site, out.covariance};
  const bool has_drifted = out.has_drift && out.drift_um > parameters.health.drift_good_um;
  ++frames_since_check;
  const bool is_due =
      parameters.check.every_frames > 0 && frames_since_check >= parameters.check.every_frames;
  if (has_drifted || (is_due && !key->checker)) {
    frames_since_check = 0;
    return CheckResult{key->features.find(image, pose.T_camera_site), pose};
  }
  if (!key->checker) return std::nullopt;
  std::optional<CheckResult> result = key->checker->take();
  if (is_due && key->checker->order(image, pose)) frames_since_check = 0;
  return result;
}

/// What the features contradict is replaced by their pose when alignment from there explains more
/// of the image. An objection stands until a check is content.
void DirectTracker::Impl::compare_features(const cv::Mat& image, MotionEstimate& out) {
  const StageTimer timer(out.times.check);
  const auto check = next_check(image, out);
  if (!check) return;
  const FeatureMotion& found = check->motion;
  objection = judge_check(found, check->of, out);
  if (out.has_drift && out.drift_um > parameters.health.drift_good_um) {
    out.status = found.fit ? TrackingStatus::degraded : TrackingStatus::lost;  // nobody knows
    out.reason = TrackingReason::drift_disagreement;
    if (!found.fit) return;
  }
  if (objection != TrackingReason::check_disagreement) return;
  const Eigen::Isometry3d T_since =
      out.T_camera_site * check->of.T_camera_site.inverse(Eigen::Isometry);
  const Alignment other =
      key->aligner.align(key->patches, pyramid, T_since * found.fit->pose.T_camera_site, 1);
  if (unsound(other) == TrackingReason::none && other.quality.inliers > out.inliers) {
    fill(other, out);
    key->chain.break_off();
  }
}

void DirectTracker::Impl::estimate(const cv::Mat& image, MotionEstimate& out) {
  {
    const StageTimer timer(out.times.pyramid);
    make_pyramid(image, pyramid);
  }
  const bool is_followed = T_newest && follow(out);
  if (!is_followed && relocalise(image, out)) {
    if (out.status == TrackingStatus::tracking) out.status = TrackingStatus::relocalised;
    T_newest.reset();
    key->chain.break_off();
  } else if (!is_followed) {
    out.status = TrackingStatus::lost;
  }
  if (out.status != TrackingStatus::lost) {
    compare_chain(out);
    if (is_followed) compare_features(image, out);
    object(out);
  }
  if (out.status == TrackingStatus::lost) {
    forget_motion();
    return;
  }
  T_before = T_newest;
  T_newest = out.T_camera_site;
  shift.remember(pyramid.levels[kCoarsest]);
}

DirectTracker::DirectTracker(const CameraModel& camera, const TrackerParameters& parameters)
    : impl_(std::make_unique<Impl>(camera, parameters)) {
  if (const auto what = invalid_camera(camera)) throw std::invalid_argument("camera: " + *what);
  if (const auto what = invalid_parameter(parameters))
    throw std::invalid_argument("tracker parameter " + *what);
}
DirectTracker::~DirectTracker() = default;
DirectTracker::DirectTracker(DirectTracker&&) noexcept = default;
DirectTracker& DirectTracker::operator=(DirectTracker&&) noexcept = default;

TrackingReason DirectTracker::set_keyframe(const cv::Mat& image, const SiteGeometry& geometry,
                                           const cv::Mat& mask) {
  Impl& s = *impl_;
  if (const TrackingReason reason = s.unusable(image); reason != TrackingReason::none)
    return reason;
  if (!mask.empty() && mask.size() != image.size()) return TrackingReason::wrong_image_size;
  if (!mask.empty() && mask.type() != CV_8UC1) return TrackingReason::wrong_image_type;
  if (invalid_geometry(s.camera, geometry)) return TrackingReason::invalid_geometry;

  const Site site(s.camera, geometry);
  const Freedom freedom = site.is_plane() ? Freedom::planar : Freedom::rigid;
  FeatureCheck features(s.camera, s.parameters);
  if (const auto reason = features.set_keyframe(image, site, mask); reason != TrackingReason::none)
    return reason;
  // A keyframe that is not found again in itself, as a pattern that repeats, proves no pose.
  if (const FeatureMotion itself = features.find(image, std::nullopt); !itself.fit)
    return itself.reason;
  GreyAndMask grey_and_mask;
  make_grey_and_mask(image, s.parameters.mask, grey_and_mask);
  cv::Mat keep_half = grey_and_mask.keep_half;
  if (!mask.empty()) keep_half &= kept_of_half(mask, keep_half.size());
  Pyramid pyramid;
  make_pyramid(image, pyramid);
  std::unique_ptr<CheckThread> checker;
  if (s.parameters.check.is_threaded) {
    FeatureCheck beside(s.camera, s.parameters);
    if (const auto reason = beside.set_keyframe(image, site, mask); reason != TrackingReason::none)
      return reason;
    checker = std::make_unique<CheckThread>(std::move(beside));
  }
  Impl::Keyframe key{site,
                     make_template(pyramid, keep_half, s.camera, site, s.parameters.direct),
                     make_witnesses(pyramid, keep_half, s.camera, site, s.parameters.direct),
                     DirectAligner(s.camera, s.parameters, freedom, site.p_pivot_mm()),
                     FrameChain(s.camera, s.parameters, freedom, site.p_pivot_mm()),
                     std::move(features),
                     std::move(checker)};
  std::size_t most = 0;
  for (const TemplateLevel& level : key.patches) most = std::max(most, level.size());
  if (key.patches[0].size() < static_cast<std::size_t>(kPatchesMin))
    return TrackingReason::too_few_features;
  key.aligner.reserve(most);
  s.key.emplace(std::move(key));
  s.t_newest.reset();
  s.forget_motion();
  s.T_newest = Eigen::Isometry3d::Identity();
  s.shift.remember(pyramid.levels[kCoarsest]);
  s.objection = TrackingReason::none;
  s.checks_failed = 0;
  s.frames_since_check = s.parameters.check.every_frames;  // the first frame is checked
  return TrackingReason::none;
}

MotionEstimate DirectTracker::track(const cv::Mat& image, std::chrono::nanoseconds t_exposure) {
  Impl& s = *impl_;
  MotionEstimate out;
  out.t_exposure = t_exposure;
  const auto start = std::chrono::steady_clock::now();
  if (s.key) out.reason = s.unusable(image);
  if (out.reason == TrackingReason::none && s.t_newest && t_exposure <= *s.t_newest)
    out.reason = TrackingReason::time_not_increasing;
  if (out.reason == TrackingReason::none) {
    s.t_newest = t_exposure;
    s.estimate(image, out);
  } else if (out.reason != TrackingReason::time_not_increasing) {
    s.forget_motion();
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
  out.times.total = std::chrono::steady_clock::now() - start;
  return out;
}

}  // namespace holdfast::perception
