// SPDX-License-Identifier: Apache-2.0
// The hand-eye file (hand_eye.json): where the camera stands in the robot's frame, how well that is
// known, and the camera calibration and optics it belongs to. Sealed by a SHA-256 over its content.
#pragma once

#include <filesystem>
#include <string>

#include <Eigen/Geometry>

#include "registration/hand_eye.hpp"

namespace holdfast::registration {

struct HandEyeCalibration {
  Eigen::Isometry3d T_robot_camera = Eigen::Isometry3d::Identity();
  /// tx,ty,tz,rx,ry,rz (mm, rad), fixed robot axes: p_robot = Exp(r)·R·p_camera + t + dt.
  Matrix6d covariance = Matrix6d::Zero();
  double zoom = 0, focus_mm = 0;
  int image_width_px = 0, image_height_px = 0;
  Eigen::Matrix3d camera_matrix = Eigen::Matrix3d::Identity();  ///< left, as calibrated
  std::string checksum;  ///< "sha256:" and 64 hex digits; set by load
};

/// Reads and verifies. Throws InputError naming the file and what is wrong: missing or mistyped
/// member, number that is not finite, rotation that is not one, covariance that is not symmetric
/// and positive semi-definite or is zero, wrong checksum.
[[nodiscard]] HandEyeCalibration load_hand_eye(const std::filesystem::path& file);

/// The file's content for a hand-eye calibration that was found with `input`, sealed, its evidence
/// beside it; `stereo_sha256` names the stereo.yaml. The caller writes it. Throws InputError on one
/// that load_hand_eye would refuse.
[[nodiscard]] std::string sealed_hand_eye(const HandEye& hand_eye, const HandEyeInput& input,
                                          const std::string& stereo_sha256);

/// The same for a record without evidence.
[[nodiscard]] std::string sealed_hand_eye(const HandEyeCalibration& calibration);

/// How far apart the calibration's camera matrix and another one place the same pixel at the
/// working distance, mm: the worst over the image. Another calibration, another zoom or another
/// camera has its frame elsewhere, and T_robot_camera does not hold there.
[[nodiscard]] double disagreement_mm(const HandEyeCalibration& calibration,
                                     const Eigen::Matrix3d& camera_matrix);

}  // namespace holdfast::registration
