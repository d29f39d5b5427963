// SPDX-License-Identifier: Apache-2.0
// Hand-eye calibration: where the left camera stands in the robot's frame, from spots of the
// robot's aiming beam that both cameras see on a surface (after paper B's manual registration of an
// ablation laser's spot). The camera's points carry the images' noise, each its own, and the stereo
// calibration's, common to all; the robot's carry what the robot's maker states. What the
// result says of a point of the site holds for this calibration at this zoom, and no other.
#pragma once

#include <string>
#include <vector>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "registration/hand_eye_fit.hpp"
#include "registration/spot_detection.hpp"
#include "registration/stereo_calibration.hpp"
#include "registration/triangulation.hpp"

namespace holdfast::registration {

struct HandEyeSpot {
  std::string name;
  ImageSpot left, right;  ///< raw pixels
  RobotSpot robot;
};

struct HandEyeLimits {
  int least_spots = 6;
  double least_distance_mm = 1;       ///< between any two spots
  double least_width_mm = 3;          ///< spread (1 sigma) along the second axis of all spots
  double least_relief_mm = 1;         ///< spread out of the plane that fits them best
  double largest_epipolar_px = 1.5;   ///< by which the two images may disagree
  double largest_scale_sigma = 0.02;  ///< else a wrong zoom would go unnoticed
  double scale_sigmas = 5;            ///< by which camera and robot may differ in scale
  double least_p = 1e-3;              ///< of all residuals together; of one spot, that over N
  double largest_sigma_mm = 0.15;  ///< predicted, in the middle of the working volume, worst axis
};

struct HandEyeInput {
  std::vector<HandEyeSpot> spots;
  ZoomCalibration calibration;  ///< at the images' zoom
  int image_width_px = 0, image_height_px = 0;
  HandEyeLimits limits;
};

enum class HandEyeStatus {
  found,
  invalid_numbers,  ///< not finite, a direction without length, no covariance of the calibration
  too_few,
  too_close,          ///< two spots in one place
  collinear,          ///< a turn about the line through them would not show
  flat,               ///< a mirrored robot frame would not show
  other_calibration,  ///< the two images disagree, or a spot lies outside the working distance
  scale_unknown,      ///< the beams leave the scale free: a wrong zoom would not show
  spot_displaced,     ///< one contradicts all others
  mirrored,           ///< a reflection fits, no motion does
  other_scale,        ///< another zoom, or the robot's points in another unit
  poor_fit,
  target_uncertain  ///< the predicted error is over its limit
};

struct LocatedSpot {
  std::string name;
  Eigen::Vector3d p_camera_mm = Eigen::Vector3d::Zero();
  double sigma_mm = 0;     ///< root of the trace of its covariance, calibration included
  double epipolar_px = 0;  ///< by which the two images disagree
  double residual_mm = 0;  ///< in robot's space; across the beam where it has one
  SpotLeftOut left_out;
};

struct HandEye {
  HandEyeStatus status = HandEyeStatus::invalid_numbers;
  std::string reason;  ///< one line with the figures; empty when found
  /// Only when found.
  Eigen::Isometry3d T_robot_camera = Eigen::Isometry3d::Identity();
  /// tx,ty,tz,rx,ry,rz (mm, rad), fixed robot axes: p_robot = Exp(r)·R·p_camera + t + dt.
  Matrix6d covariance = Matrix6d::Zero();
  double rms_mm = 0, chi_squared = 0, p_value = 0;
  int degrees_of_freedom = 0;
  SpotScale scale;
  Eigen::Vector3d p_middle_camera_mm = Eigen::Vector3d::Zero();     ///< of the working volume
  Eigen::Matrix3d covariance_middle_mm2 = Eigen::Matrix3d::Zero();  ///< predicted there, robot axes
  std::vector<LocatedSpot> spots;  ///< also when refused, as far as it came
};

/// Pure, re-entrant; allocates. Not for the real-time path.
[[nodiscard]] HandEye find_hand_eye(const HandEyeInput& input);

/// Each spot's place, with the disagreement of its two images.
[[nodiscard]] std::vector<TriangulatedPoint> triangulated_spots(const HandEyeInput& input);

/// The spots' points (camera frame) and their joint 3Nx3N covariance: each its images' noise, all
/// the calibration's.
[[nodiscard]] std::vector<Eigen::Vector3d> locate_spots(const HandEyeInput& input,
                                                        Eigen::MatrixXd& joint_covariance_mm2);

}  // namespace holdfast::registration
