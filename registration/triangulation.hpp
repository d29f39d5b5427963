// SPDX-License-Identifier: Apache-2.0
// Points from a calibrated stereo pair: raw pixels of both images to the left camera's frame.
#pragma once

#include <vector>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "registration/stereo_calibration.hpp"

namespace holdfast::registration {

/// Undistorted, normalised coordinates (x/z, y/z) of raw pixels.
[[nodiscard]] std::vector<Eigen::Vector2d> rays(const std::vector<cv::Point2d>& pixels,
                                                const cv::Matx33d& camera_matrix,
                                                const cv::Mat& distortion);

struct TriangulatedPoint {
  Eigen::Vector3d p_camera_mm = Eigen::Vector3d::Zero();  ///< may lie behind the cameras: judge it
  double epipolar_px = 0;  ///< distance of the right point from the left one's epipolar line, in
                           ///< undistorted pixels of the right image
};

/// Least squares of the reprojection error in normalised coordinates, scaled to pixels. Sizes
/// equal.
[[nodiscard]] std::vector<TriangulatedPoint> triangulate(const std::vector<cv::Point2d>& left,
                                                         const std::vector<cv::Point2d>& right,
                                                         const ZoomCalibration& zoom);

/// The rigid motion (no scale) that takes `from` nearest to `to` in the least-squares sense.
[[nodiscard]] Eigen::Isometry3d rigid_fit(const std::vector<Eigen::Vector3d>& from,
                                          const std::vector<Eigen::Vector3d>& to);

/// Where a rigid body of known points (in its own frame) stands in the left camera's frame, from
/// their pixels in both views together: one alone leaves a board's tilt ambiguous at a long focal
/// length. Rotation vector, then translation in mm.
[[nodiscard]] Eigen::Matrix<double, 6, 1> triangulated_pose(
    const std::vector<cv::Point2d>& left, const std::vector<cv::Point2d>& right,
    const std::vector<Eigen::Vector3d>& points_mm, const ZoomCalibration& zoom);

/// Root mean square of what rigid_fit() leaves, mm.
[[nodiscard]] double rigid_residual_mm(const std::vector<Eigen::Vector3d>& from,
                                       const std::vector<Eigen::Vector3d>& to);

}  // namespace holdfast::registration
