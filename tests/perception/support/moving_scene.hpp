// SPDX-License-Identifier: Apache-2.0
// A real photograph as the surface of a site that moves by a known amount, seen by a known camera.
// Pixels are interpolated in floating point with a six-tap Lanczos kernel, since OpenCV's warps
// quantise positions to 1/32 px.
#pragma once

#include <cstdint>
#include <string>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "perception/camera_model.hpp"
#include "perception/motion_estimate.hpp"
#include "perception/tracker.hpp"

namespace holdfast::test {

/// Folders of real data that Debian packages install (config/debian-packages.txt).
inline const std::string visp_images = "/usr/share/visp-images-data/ViSP-images/";
inline const std::string opencv_data = "/usr/share/doc/opencv-doc/examples/data/";

/// A camera with 20 um per pixel at 200 mm, its principal point a little off the image centre.
[[nodiscard]] perception::CameraModel microscope_camera(int width_px, int height_px);
/// The same with a distortion of some pixels at the corners.
[[nodiscard]] perception::CameraModel distorted_camera(int width_px, int height_px);

/// A real photograph of at least 1920x1080 px, band-limited slightly so that it can be interpolated
/// faithfully; CV_32FC1 or CV_32FC3. Throws when it is not installed.
[[nodiscard]] cv::Mat photograph(bool in_colour = false);
/// Another one, that shows something else.
[[nodiscard]] cv::Mat other_photograph();

class MovingScene {
 public:
  /// A plane at `depth_mm`, or, with relief_mm > 0, a smooth surface that departs from it by up to
  /// that much. The middle of the texture lies on the camera's axis.
  MovingScene(const perception::CameraModel& camera, const cv::Mat& texture, double depth_mm,
              double relief_mm = 0);

  /// What the camera sees when the site has moved: CV_8U with the texture's channels, noise of
  /// `noise` grey levels, deterministic in `seed`.
  [[nodiscard]] cv::Mat image(const Eigen::Isometry3d& T_camera_site, double noise = 2,
                              std::uint64_t seed = 1) const;
  /// Depth on the keyframe's undistorted pixel grid.
  [[nodiscard]] cv::Mat depth_mm() const;
  /// Also of what lies beside the keyframe's image, by so many pixels.
  [[nodiscard]] perception::SiteDepth wide_depth(int beside_px) const;
  [[nodiscard]] Eigen::Vector3d p_pivot_mm() const { return {0, 0, surface_mm(0, 0)}; }

 private:
  /// Depth of the surface on the keyframe ray (x, y, 1).
  [[nodiscard]] double surface_mm(double x, double y) const;
  perception::CameraModel camera_;
  cv::Mat texture_;
  double depth_mm_, relief_mm_;
  std::vector<cv::Point2d> rays_;  // of every pixel, row by row
};

/// Translation (mm) and a rotation vector (rad) about the pivot, as a pose of the site.
[[nodiscard]] Eigen::Isometry3d moved_about(const Eigen::Vector3d& pivot_mm,
                                            const Eigen::Vector3d& t_mm,
                                            const Eigen::Vector3d& r_rad);

/// How far the truth is from the estimate, in the order and axes of MotionEstimate::covariance.
[[nodiscard]] Eigen::Matrix<double, 6, 1> error_of(const perception::MotionEstimate& estimate,
                                                   const Eigen::Isometry3d& T_camera_site);

}  // namespace holdfast::test
