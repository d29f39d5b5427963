// SPDX-License-Identifier: Apache-2.0
// Labelled points in 3D Slicer's markups format (.mrk.json, fiducial list), mm. CT points are LPS;
// a RAS file is converted. Points of the camera's frame are written unchanged as LPS. What 3D
// Slicer has no place for (and drops when it saves) stands in the file's own member `holdfast`:
//   {"properties": {name: text}, "joint_covariance_mm2": [(3N)² numbers, row by row]}
#pragma once

#include <map>
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

/// Properties that tell which CT the points were taken from (registration::CtIdentity).
inline constexpr const char* kCtSeriesUid = "ct_series_uid";
inline constexpr const char* kCtStudyUid = "ct_study_uid";
inline constexpr const char* kCtFrameOfReferenceUid = "ct_frame_of_reference_uid";

struct Markups {
  std::vector<MarkupPoint> points;
  std::map<std::string, std::string> properties;  ///< empty in a file that 3D Slicer saved
  /// 3N x 3N, same axes as the positions: x y z of points[0], then of points[1], ...; for errors
  /// that the points share. Empty (0 x 0) when unknown.
  Eigen::MatrixXd joint_covariance_mm2;
};

/// Throws InputError naming file and fault: not JSON, no control points, a number that is not
/// finite, an unknown coordinate system or unit, a covariance that is not symmetric and positive
/// semi-definite, more than 10,000 points; a property that is not a text, a joint covariance that
/// is not 3N x 3N for the N placed points, differs from a point's own, or is of more than 300.
[[nodiscard]] Markups read_markups_file(const std::string& path);

/// The file's content (LPS, mm); the caller writes it. Throws std::invalid_argument for a joint
/// covariance that is neither empty nor 3N x 3N.
[[nodiscard]] std::string markups_text(const Markups& markups);

/// The points alone.
[[nodiscard]] std::vector<MarkupPoint> read_markups(const std::string& path);
[[nodiscard]] std::string markups_text(const std::vector<MarkupPoint>& points);

}  // namespace holdfast::registration
