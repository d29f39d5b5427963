// SPDX-License-Identifier: Apache-2.0
// What holds for every tracker of this house: what it refuses to look at, how a pose becomes the
// numbers of an estimate, and what is left of an estimate when the site is lost. Any thread; no
// state.
#pragma once

#include <chrono>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "perception/camera_model.hpp"
#include "perception/motion_estimate.hpp"
#include "perception/site.hpp"
#include "perception/tracker_parameters.hpp"

namespace holdfast::perception {

/// Throws std::invalid_argument, in one line, for what invalid_camera() or invalid_parameter()
/// names.
void require_valid(const CameraModel& camera, const TrackerParameters& parameters);

/// Why no frame of this camera looks like that; none when it may be one.
[[nodiscard]] TrackingReason unusable_image(const CameraModel& camera, const cv::Mat& image);
/// As unusable_image(), and what is wrong with geometry or mask (CV_8UC1 of the image's size, or
/// empty).
[[nodiscard]] TrackingReason unusable_keyframe(const CameraModel& camera, const cv::Mat& image,
                                               const SiteGeometry& geometry, const cv::Mat& mask);

/// Where a ray to `p` meets the plane z = 1.
[[nodiscard]] inline Eigen::Vector2d project(const Eigen::Vector3d& p) {
  return p.head<2>() / p.z();
}
/// How far apart two poses see a point of the site, in the image plane, in µm at the point as the
/// first sees it.
[[nodiscard]] double displacement_um(const Eigen::Isometry3d& T_a_site,
                                     const Eigen::Isometry3d& T_b_site,
                                     const Eigen::Vector3d& p_site_mm);

/// The pose with its covariance about the site's pivot, and the planar numbers that follow from it
/// (dx_um, dy_um, rotation_rad, scale).
void set_pose(const Eigen::Isometry3d& T_camera_site, const Matrix6d& covariance, const Site& site,
              MotionEstimate& out);

/// Of a lost frame: reason, time, counts and stage times. No other number of it may be mistaken for
/// a pose.
[[nodiscard]] MotionEstimate without_pose(const MotionEstimate& lost);

}  // namespace holdfast::perception
