// SPDX-License-Identifier: Apache-2.0
// The space that both cameras of a calibrated microscope see, and what a change of the
// calibration's parameters does to points measured there.
#pragma once

#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "registration/stereo_calibration.hpp"

namespace holdfast::registration {

struct WorkingVolume {
  std::vector<Eigen::Vector3d> p_camera_mm;
  std::vector<cv::Point2d> left, right;  ///< where they are seen, raw px
};

struct VolumeExtent {
  double field = 1;    ///< share of the left image's width and height, about its middle
  double reach = 0.1;  ///< of the depth, each way
};

/// A grid of points about `depth_mm`, those that both cameras see; may be empty.
[[nodiscard]] WorkingVolume working_volume(const ZoomCalibration& zoom, int image_width_px,
                                           int image_height_px, double depth_mm,
                                           const VolumeExtent& extent = {});

/// Where the points of `volume` move, 3NxK mm, for each of K changes of parameter_vector(zoom)
/// (columns). Linear: of a small part of the change.
[[nodiscard]] Eigen::MatrixXd displacements(const WorkingVolume& volume,
                                            const ZoomCalibration& zoom,
                                            const Eigen::MatrixXd& changes);

/// 3Nx6: displacements of points per mm along and per rad about the axes through their middle.
[[nodiscard]] Eigen::MatrixXd rigid_motions(const std::vector<Eigen::Vector3d>& points_mm);

/// `displacements` less their best rigid motion of `points_mm`, column by column.
[[nodiscard]] Eigen::MatrixXd without_rigid(const std::vector<Eigen::Vector3d>& points_mm,
                                            const Eigen::MatrixXd& displacements);

/// The covariance of `zoom` relative to the frame that the calibration itself defines. Where this
/// frame stands in the lens is known ten times worse than distances in it (a turn of the camera
/// looks like a move of its principal point), and matters to nobody who measures everything with
/// one calibration, the robot's hand-eye transform included. Of each change of the parameters the
/// change that moves the working volume rigidly in the same way is taken off.
[[nodiscard]] Eigen::MatrixXd covariance_in_own_frame(const ZoomCalibration& zoom,
                                                      int image_width_px, int image_height_px,
                                                      double depth_mm);

/// Columns whose outer products sum to `covariance` (positive semi-definite).
[[nodiscard]] Eigen::MatrixXd covariance_root(const Eigen::MatrixXd& covariance);

}  // namespace holdfast::registration
