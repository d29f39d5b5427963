// SPDX-License-Identifier: Apache-2.0
// Feature-based tracking of the site against a keyframe (paper B, sections 2.2.2-2.2.5): reflection
// mask, ORB, matching, RANSAC; anchored to the keyframe and, beside it, frame to frame, so that the
// drift between the two is known for every frame.
#pragma once

#include <memory>
#include <optional>
#include <variant>

#include <opencv2/core.hpp>

#include "perception/camera_model.hpp"
#include "perception/motion_estimate.hpp"

namespace holdfast::perception {

/// The site is taken as a plane facing the camera; planar motion (x, y, z from scale, rotation
/// about z) is estimated, tilt is not, and its covariance says so.
struct SitePlane {
  double depth_mm = 0;
};
/// An undistorted pixel grid: u = fx x/z + cx, v = fy y/z + cy.
struct PixelGrid {
  double fx_px = 0, fy_px = 0, cx_px = 0, cy_px = 0;
};
/// The site's depth (CV_32F, mm, NaN where unknown): full 6-DoF motion is estimated.
struct SiteDepth {
  cv::Mat depth_mm;
  /// The grid of the map; by default the keyframe's own, undistorted.
  std::optional<PixelGrid> grid = std::nullopt;
  /// From the camera to the frame whose z the map holds: R1 for rectified depth.
  Eigen::Matrix3d R_depth_camera = Eigen::Matrix3d::Identity();
};
using SiteGeometry = std::variant<SitePlane, SiteDepth>;

struct TrackerParameters;  // perception/tracker_parameters.hpp

class Tracker {
 public:
  /// One thread at a time. Uses the calling thread only (OpenCV's thread pool is left as the caller
  /// set it).
  /// Throws std::invalid_argument, in one line, for what invalid_camera() or invalid_parameter()
  /// would name.
  Tracker(const CameraModel& camera, const TrackerParameters& parameters);
  ~Tracker();
  Tracker(Tracker&&) noexcept;
  Tracker& operator=(Tracker&&) noexcept;
  Tracker(const Tracker&) = delete;
  Tracker& operator=(const Tracker&) = delete;

  /// Takes `image` (CV_8UC1 or BGR CV_8UC3) as the keyframe, with what is known of the site's
  /// geometry and an optional mask (CV_8UC1, 0 = no feature of the keyframe is taken here; what a
  /// later frame shows there matches nothing). Returns TrackingReason::none, or why the
  /// image cannot serve; then the former keyframe, if any, stays.
  [[nodiscard]] TrackingReason set_keyframe(const cv::Mat& image, const SiteGeometry& geometry,
                                            const cv::Mat& mask = {});

  /// Estimates the motion of the site from the keyframe to `image`. Frames are taken as
  /// consecutive; `t_exposure` must be later than at every call before, otherwise the frame is lost
  /// and nothing else happens. Allocates; not for the real-time thread.
  [[nodiscard]] MotionEstimate track(const cv::Mat& image, std::chrono::nanoseconds t_exposure);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace holdfast::perception
