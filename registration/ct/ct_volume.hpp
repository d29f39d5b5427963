// SPDX-License-Identifier: Apache-2.0
// A CT volume in patient coordinates. Frame ct: LPS, mm (x to the patient's left, y to the back,
// z to the head). Index (i, j, k) = column, row, slice; a voxel's value belongs to its centre.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include <Eigen/Geometry>

namespace holdfast::registration {

/// What ties a surface or a point to the scan it was taken from.
struct CtIdentity {
  std::string series_uid, study_uid, frame_of_reference_uid;
};

struct CtVolume {
  std::array<int, 3> size = {0, 0, 0};                        ///< columns, rows, slices
  std::vector<std::int16_t> hu;                               ///< column fastest, then row
  Eigen::Vector3d column_step_mm = Eigen::Vector3d::UnitX();  ///< from one column to the next
  Eigen::Vector3d row_step_mm = Eigen::Vector3d::UnitY();     ///< from one row to the next
  /// Centre of voxel (0, 0, k) for every k. Each slice stands where its own file says, so a gantry
  /// tilt or an uneven step of the table is in here and nowhere else.
  std::vector<Eigen::Vector3d> slice_origin_mm;
  CtIdentity identity;
  std::string description;         ///< of the series
  std::vector<std::string> notes;  ///< what was skipped, dropped, corrected or clipped

  /// Position of a point between voxel centres, frame ct: linear between neighbouring slices,
  /// extrapolated beyond the first and the last. Needs two slices.
  [[nodiscard]] Eigen::Vector3d point_at(const Eigen::Vector3d& index) const;
  /// The best affine map from index to frame ct; exact but for uneven slice positions.
  [[nodiscard]] Eigen::Affine3d ct_from_index() const;
};

}  // namespace holdfast::registration
