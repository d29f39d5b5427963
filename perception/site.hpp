// SPDX-License-Identifier: Apache-2.0
// What is known of the site's shape under the keyframe: lifts keyframe pixels to points of the
// site, and meets rays of any later view with the surface.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "perception/camera_model.hpp"
#include "perception/tracker.hpp"

namespace holdfast::perception {

class Site {
 public:
  Site() = default;
  /// `geometry` must have passed invalid_geometry(). A depth map is copied.
  Site(const CameraModel& camera, const SiteGeometry& geometry);

  [[nodiscard]] bool is_plane() const noexcept { return depth_mm_.empty(); }
  /// The site point on the optical axis; without depth there, the nearest depth known around it.
  [[nodiscard]] const Eigen::Vector3d& p_pivot_mm() const noexcept { return p_pivot_mm_; }
  /// The site point seen at the image centre at the keyframe, found likewise.
  [[nodiscard]] const Eigen::Vector3d& p_centre_mm() const noexcept { return p_centre_mm_; }

  /// The site point on the keyframe ray (x/z, y/z). Nothing where the depth is unknown or steps.
  [[nodiscard]] std::optional<Eigen::Vector3d> lift(const Eigen::Vector2d& ray) const;
  /// The site point that a camera at T_camera_site sees along `ray`. Nothing as in lift(), or when
  /// the search does not settle.
  [[nodiscard]] std::optional<Eigen::Vector3d> meet(const Eigen::Vector2d& ray,
                                                    const Eigen::Isometry3d& T_camera_site) const;
  /// The plane that fits the site around the keyframe ray, within `reach` (x/z) on each side: n
  /// with n . p = 1 for its points p (mm). Nothing where a quarter of the depth is unknown, or
  /// where it departs from a plane as an edge does.
  [[nodiscard]] std::optional<Eigen::Vector3d> plane_near(const Eigen::Vector2d& ray,
                                                          double reach) const;

 private:
  // In the depth map's own frame.
  [[nodiscard]] std::optional<double> depth_at(const Eigen::Vector2d& depth_ray) const;
  // In the camera's.
  [[nodiscard]] double depth_near(const Eigen::Vector2d& ray) const;
  PixelGrid grid_;
  Eigen::Matrix3d R_depth_camera_ = Eigen::Matrix3d::Identity();
  double plane_mm_ = 0;
  cv::Mat depth_mm_;
  Eigen::Vector3d p_pivot_mm_ = Eigen::Vector3d::Zero();
  Eigen::Vector3d p_centre_mm_ = Eigen::Vector3d::Zero();
};

/// What is wrong with the geometry for this camera, in one line with value, limit and unit; empty
/// when it is usable: a plane in front of the camera, or a CV_32F map of the image's size (of any
/// size with a grid of its own) with depth at 2 % of its pixels at least, none of it behind or in
/// the camera.
[[nodiscard]] std::optional<std::string> invalid_geometry(const CameraModel& camera,
                                                          const SiteGeometry& geometry);

}  // namespace holdfast::perception
