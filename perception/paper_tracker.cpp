// SPDX-License-Identifier: Apache-2.0
#include "perception/paper_tracker.hpp"

#include <cmath>
#include <limits>
#include <optional>
#include <vector>

#include <opencv2/calib3d.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>

#include "perception/reflection_mask.hpp"
#include "perception/site.hpp"
#include "perception/stage_timer.hpp"
#include "perception/tracker_parameters.hpp"
#include "perception/tracker_rules.hpp"

namespace holdfast::perception {
namespace {

constexpr int kFeatures = 2000;     // k of section 2.2.4
constexpr int kMatchesMin = 10;     // an affine motion needs three
constexpr double kThresholdPx = 3;  // OpenCV's own default; the paper names none
constexpr std::size_t kIterations = 2000;

struct Frame {
  std::vector<cv::KeyPoint> corners;
  cv::Mat descriptors;
};

cv::Matx33d as_square(const cv::Mat& affine) {
  cv::Matx33d A = cv::Matx33d::eye();
  for (int i = 0; i < 2; ++i)
    for (int j = 0; j < 3; ++j) A(i, j) = affine.at<double>(i, j);
  return A;
}

}  // namespace

struct PaperTracker::Impl {
  CameraModel camera;
  ReflectionMaskParameters mask_parameters;
  cv::Ptr<cv::ORB> orb = cv::ORB::create(kFeatures);
  cv::BFMatcher matcher{cv::NORM_HAMMING, true};
  std::optional<Site> site;
  Frame before;
  GreyAndMask images;
  cv::Matx33d cascade = cv::Matx33d::eye();
  std::optional<std::chrono::nanoseconds> t_newest;

  Impl(const CameraModel& c, const TrackerParameters& p) : camera(c), mask_parameters(p.mask) {
    camera.distortion = c.distortion.clone();
  }
  [[nodiscard]] Frame see(const cv::Mat& image, const cv::Mat& mask, StageTimes& times);
  [[nodiscard]] std::optional<cv::Matx33d> step_to(const Frame& now, MotionEstimate& out);
  [[nodiscard]] Eigen::Isometry3d pose() const;
};

Frame PaperTracker::Impl::see(const cv::Mat& image, const cv::Mat& mask, StageTimes& times) {
  Frame frame;
  cv::Mat keep;
  {
    const StageTimer timer(times.mask);
    make_grey_and_mask(image, mask_parameters, images);
    cv::resize(images.keep_half, keep, images.grey.size(), 0, 0, cv::INTER_NEAREST);
    if (!mask.empty()) keep &= mask;
  }
  const StageTimer timer(times.detect);
  orb->detectAndCompute(images.grey, keep, frame.corners, frame.descriptors);
  return frame;
}

/// The affine motion of the image since the frame before.
std::optional<cv::Matx33d> PaperTracker::Impl::step_to(const Frame& now, MotionEstimate& out) {
  out.features = static_cast<int>(now.corners.size());
  out.reason = TrackingReason::too_few_features;
  if (now.descriptors.empty() || before.descriptors.empty()) return std::nullopt;
  std::vector<cv::DMatch> matches;
  {
    const StageTimer timer(out.times.match);
    matcher.match(before.descriptors, now.descriptors, matches);
  }
  out.matches = static_cast<int>(matches.size());
  out.reason = TrackingReason::too_few_matches;
  if (out.matches < kMatchesMin) return std::nullopt;
  const StageTimer timer(out.times.model);
  std::vector<cv::Point2f> from, to;
  for (const cv::DMatch& match : matches) {
    from.push_back(before.corners[static_cast<std::size_t>(match.queryIdx)].pt);
    to.push_back(now.corners[static_cast<std::size_t>(match.trainIdx)].pt);
  }
  std::vector<uchar> is_inlier;
  const cv::Mat affine =
      cv::estimateAffine2D(from, to, is_inlier, cv::RANSAC, kThresholdPx, kIterations);
  out.inliers = cv::countNonZero(is_inlier);
  out.reason = TrackingReason::too_few_inliers;
  if (affine.empty() || out.inliers < kMatchesMin) return std::nullopt;
  out.reason = TrackingReason::none;
  return as_square(affine);
}

/// Of the site: where the cascade has taken the image's centre, turned and scaled as it says.
Eigen::Isometry3d PaperTracker::Impl::pose() const {
  const Eigen::Vector3d& p_site = site->p_centre_mm();
  const cv::Vec3d q =
      cascade * cv::Vec3d(0.5 * (camera.width_px - 1), 0.5 * (camera.height_px - 1), 1);
  const auto ray = to_normalised(camera, {{q[0], q[1]}}).front();
  const double scale =
      std::sqrt(std::abs(cascade(0, 0) * cascade(1, 1) - cascade(0, 1) * cascade(1, 0)));
  const double angle = std::atan2(cascade(1, 0) - cascade(0, 1), cascade(0, 0) + cascade(1, 1));
  const Eigen::Matrix3d R = Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  const Eigen::Vector3d p = Eigen::Vector3d(ray.x, ray.y, 1) * (p_site.z() / scale);
  Eigen::Isometry3d T_camera_site = Eigen::Isometry3d::Identity();
  T_camera_site.linear() = R;
  T_camera_site.translation() = p - R * p_site;
  return T_camera_site;
}

PaperTracker::PaperTracker(const CameraModel& camera, const TrackerParameters& parameters)
    : impl_(std::make_unique<Impl>(camera, parameters)) {
  require_valid(camera, parameters);
}
PaperTracker::~PaperTracker() = default;
PaperTracker::PaperTracker(PaperTracker&&) noexcept = default;
PaperTracker& PaperTracker::operator=(PaperTracker&&) noexcept = default;

TrackingReason PaperTracker::set_keyframe(const cv::Mat& image, const SiteGeometry& geometry,
                                          const cv::Mat& mask) {
  Impl& s = *impl_;
  if (const auto reason = unusable_keyframe(s.camera, image, geometry, mask);
      reason != TrackingReason::none)
    return reason;
  StageTimes times;
  Frame frame = s.see(image, mask, times);
  if (frame.descriptors.rows < kMatchesMin) return TrackingReason::too_few_features;
  s.before = std::move(frame);
  s.site.emplace(s.camera, geometry);
  s.cascade = cv::Matx33d::eye();
  s.t_newest.reset();
  return TrackingReason::none;
}

MotionEstimate PaperTracker::track(const cv::Mat& image, std::chrono::nanoseconds t_exposure) {
  Impl& s = *impl_;
  MotionEstimate out;
  out.t_exposure = t_exposure;
  const auto start = std::chrono::steady_clock::now();
  if (s.site) out.reason = unusable_image(s.camera, image);
  if (out.reason == TrackingReason::none && s.t_newest && t_exposure <= *s.t_newest)
    out.reason = TrackingReason::time_not_increasing;
  if (out.reason != TrackingReason::none) return out;
  s.t_newest = t_exposure;
  Frame now = s.see(image, {}, out.times);
  if (const auto step = s.step_to(now, out)) {
    s.cascade = *step * s.cascade;
    const Matrix6d unknown = Matrix6d::Constant(std::numeric_limits<double>::quiet_NaN());
    set_pose(s.pose(), unknown, *s.site, out);
    out.status = TrackingStatus::tracking;
  }
  s.before = std::move(now);
  if (out.status == TrackingStatus::lost) out = without_pose(out);
  out.times.total = std::chrono::steady_clock::now() - start;
  return out;
}

}  // namespace holdfast::perception
