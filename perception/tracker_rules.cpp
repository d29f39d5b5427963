// SPDX-License-Identifier: Apache-2.0
#include "perception/tracker_rules.hpp"

#include <cmath>
#include <stdexcept>

namespace holdfast::perception {

void require_valid(const CameraModel& camera, const TrackerParameters& parameters) {
  if (const auto what = invalid_camera(camera)) throw std::invalid_argument("camera: " + *what);
  if (const auto what = invalid_parameter(parameters))
    throw std::invalid_argument("tracker parameter " + *what);
}

TrackingReason unusable_image(const CameraModel& camera, const cv::Mat& image) {
  if (image.dims != 2 || image.cols != camera.width_px || image.rows != camera.height_px)
    return TrackingReason::wrong_image_size;
  if (image.type() != CV_8UC1 && image.type() != CV_8UC3) return TrackingReason::wrong_image_type;
  return TrackingReason::none;
}

TrackingReason unusable_keyframe(const CameraModel& camera, const cv::Mat& image,
                                 const SiteGeometry& geometry, const cv::Mat& mask) {
  if (const auto reason = unusable_image(camera, image); reason != TrackingReason::none)
    return reason;
  if (!mask.empty() && mask.size() != image.size()) return TrackingReason::wrong_image_size;
  if (!mask.empty() && mask.type() != CV_8UC1) return TrackingReason::wrong_image_type;
  return invalid_geometry(camera, geometry) ? TrackingReason::invalid_geometry
                                            : TrackingReason::none;
}

double displacement_um(const Eigen::Isometry3d& T_a_site, const Eigen::Isometry3d& T_b_site,
                       const Eigen::Vector3d& p_site_mm) {
  const Eigen::Vector3d p = T_a_site * p_site_mm, q = T_b_site * p_site_mm;
  return 1000 * p.z() * (project(q) - project(p)).norm();
}

void set_pose(const Eigen::Isometry3d& T_camera_site, const Matrix6d& covariance, const Site& site,
              MotionEstimate& out) {
  out.T_camera_site = T_camera_site;
  out.covariance = covariance;
  out.p_pivot_site_mm = site.p_pivot_mm();
  const Eigen::Vector3d& p = site.p_centre_mm();
  const Eigen::Vector3d q = T_camera_site * p;
  const Eigen::Vector2d moved_um = 1000 * p.z() * (project(q) - project(p));
  out.dx_um = moved_um.x();
  out.dy_um = moved_um.y();
  const Eigen::Matrix3d R = T_camera_site.linear();
  out.rotation_rad = std::atan2(R(1, 0) - R(0, 1), R(0, 0) + R(1, 1));
  out.scale = p.z() / q.z();
}

MotionEstimate without_pose(const MotionEstimate& lost) {
  MotionEstimate out;
  out.reason = lost.reason;
  out.t_exposure = lost.t_exposure;
  out.features = lost.features;
  out.matches = lost.matches;
  out.times = lost.times;
  return out;
}

}  // namespace holdfast::perception
