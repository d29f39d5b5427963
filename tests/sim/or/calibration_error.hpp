// SPDX-License-Identifier: Apache-2.0
// How wrong a calibration is where it matters: points of the working volume, seen through the true
// optics, triangulated as the pipeline would.
#pragma once

#include <vector>

#include <Eigen/Geometry>

#include "registration/stereo_calibration.hpp"
#include "tests/sim/or/optics.hpp"

namespace holdfast::sim {

struct CalibrationError {
  double zoom = 0;
  double non_rigid_rms_mm = 0;  ///< what no rigid motion takes away
  double non_rigid_max_mm = 0;
  double scale = 1;            ///< of the similarity that fits best; for information
  double epipolar_rms_px = 0;  ///< distance of the two lines of sight, in pixels at the focus
  int points = 0;
};

/// The error of `model` for images taken through `optics`. Points: working_volume() of `optics`.
[[nodiscard]] CalibrationError calibration_error(const registration::ZoomCalibration& model,
                                                 const StereoOptics& optics);

/// From the head to the camera as `model` has it: the rigid motion that takes working_volume() to
/// where the model sees it through `optics`. What of a calibration no measurement with it can tell.
[[nodiscard]] Eigen::Isometry3d frame_of(const registration::ZoomCalibration& model,
                                         const StereoOptics& optics);

/// p (frame of model's left camera) of a pixel pair: the middle of the shortest line between both
/// lines of sight. `gap_mm`, if given, receives that line's length.
[[nodiscard]] Eigen::Vector3d triangulate(const registration::ZoomCalibration& model,
                                          const Eigen::Vector2d& left_px,
                                          const Eigen::Vector2d& right_px,
                                          double* gap_mm = nullptr);

/// T_b_a of least squares, both of the same length, three points or more.
[[nodiscard]] Eigen::Isometry3d fit_rigid(const std::vector<Eigen::Vector3d>& a,
                                          const std::vector<Eigen::Vector3d>& b);

}  // namespace holdfast::sim
