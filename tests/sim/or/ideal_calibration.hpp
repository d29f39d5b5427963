// SPDX-License-Identifier: Apache-2.0
// The best that a calibration with OpenCV's five coefficients can be: fitted to the true optics
// itself, without noise, over the working volume. It defines what `camera` means in a truth file,
// and what error is left when nothing else goes wrong.
#pragma once

#include <vector>

#include <Eigen/Geometry>

#include "registration/stereo_calibration.hpp"
#include "tests/sim/or/optics.hpp"

namespace holdfast::sim {

/// Points that both cameras see: a grid over the field and `depth_mm` about the focal plane each
/// way, frame head.
[[nodiscard]] std::vector<Eigen::Vector3d> working_volume(const StereoOptics& optics,
                                                          double depth_mm = 10, int columns = 13,
                                                          int rows = 11, int layers = 5);

struct IdealCalibration {
  registration::ZoomCalibration model;
  /// From the head to the left camera of `model`: with T_head_ct it gives the true T_camera_ct.
  Eigen::Isometry3d T_camera_head = Eigen::Isometry3d::Identity();
};

/// `optics` as of visit 0, as no calibration knows how the next visit will seat.
[[nodiscard]] IdealCalibration ideal_calibration(const StereoOptics& optics);

}  // namespace holdfast::sim
