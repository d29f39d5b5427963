// SPDX-License-Identifier: Apache-2.0
// Labelled points in 3D Slicer's markups format (.mrk.json, fiducial list), mm. CT points are LPS;
// a RAS file is converted. Points of the camera's frame are written unchanged as LPS.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

namespace holdfast::registration {

struct MarkupPoint {
  std::string label;
  Eigen::Vector3d position_mm = Eigen::Vector3d::Zero();
  std::optional<Eigen::Matrix3d> covariance_mm2;  ///< same axes as the position
  std::string description;                        ///< free text that 3D Slicer shows
};

/// Throws InputError naming file and fault: not JSON, no control points, a number that is not
/// finite, an unknown coordinate system or unit, a covariance that is not symmetric and positive
/// semi-definite, more than 10,000 points.
[[nodiscard]] std::vector<MarkupPoint> read_markups(const std::string& path);

/// The file's content (LPS, mm); the caller writes it.
[[nodiscard]] std::string markups_text(const std::vector<MarkupPoint>& points);

}  // namespace holdfast::registration
