// SPDX-License-Identifier: Apache-2.0
// A hand-eye calibration with known truth: spots of an aiming beam on a relief, as the true
// cameras, a little off their calibration, see them, and as an imperfect robot reports them.
#pragma once

#include <cstdint>
#include <random>

#include <Eigen/Geometry>

#include "registration/hand_eye.hpp"

namespace holdfast::registration::test {

struct DrawnSpots {
  std::uint32_t seed = 1;
  int count = 12;
  bool has_beams = false;       ///< lines instead of points; from origins 30 mm apart
  double pixel_sigma_px = 0.1;  ///< of each spot's centre; 0: exact
  double robot_sigma_mm = 0.05, robot_sigma_rad = 2e-4;
  double calibration_sigma = 1;  ///< how far the truth is from the calibration; 0: exact
  double relief_mm = 8;          ///< half the range of heights; 0: a plane
  double width_mm = 40, height_mm = 30;
};

struct DrawnHandEye {
  HandEyeInput input;
  ZoomCalibration truth;
  Eigen::Isometry3d T_robot_camera = Eigen::Isometry3d::Identity();
};

/// The calibration that is taken for true, with its covariance: f 5000 px, 1600x1200 px, 24 mm
/// base, 200 mm away.
[[nodiscard]] ZoomCalibration drawn_calibration();

[[nodiscard]] DrawnHandEye draw_hand_eye(const DrawnSpots& options);

/// Where `p_camera_mm` is seen, raw pixels.
[[nodiscard]] Eigen::Vector2d seen(const ZoomCalibration& zoom, bool is_left,
                                   const Eigen::Vector3d& p_camera_mm);

/// The spot's place by the calibration that is taken for true.
[[nodiscard]] Eigen::Vector3d triangulated(const HandEyeInput& input, const HandEyeSpot& spot);

}  // namespace holdfast::registration::test
