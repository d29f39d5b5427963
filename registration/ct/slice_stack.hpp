// SPDX-License-Identifier: Apache-2.0
// Where the slices of one CT series stand, and in which order: decided from ImagePositionPatient
// and ImageOrientationPatient alone, never from file names or instance numbers.
#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

namespace holdfast::registration {

/// One slice as its own file describes it.
struct SliceGeometry {
  std::string name;                                      ///< for messages: the file
  Eigen::Vector3d origin_mm = Eigen::Vector3d::Zero();   ///< centre of its first pixel, LPS
  Eigen::Vector3d along_row = Eigen::Vector3d::UnitX();  ///< unit: direction of growing column
  Eigen::Vector3d along_column = Eigen::Vector3d::UnitY();
  double row_spacing_mm = 1, column_spacing_mm = 1;  ///< between rows, between columns
  int rows = 0, columns = 0;
  std::optional<double> tilt_deg;  ///< GantryDetectorTilt
};

struct SliceStack {
  /// Indices into the slices given, ascending along row x column: so column, row and slice are
  /// always right-handed. Slices at one position stand together in `duplicates` instead.
  std::vector<std::size_t> order;
  /// Pairs (kept, other) at the same position; the caller compares their pixels.
  std::vector<std::pair<std::size_t, std::size_t>> duplicates;
  std::vector<std::string> notes;
};

/// How exact the positions must be.
struct SliceLimits {
  double same_position_mm = 0.001;
  double corner_mm = 0.02;   ///< how far different orientations may move a slice's corner
  double spacing_mm = 0.05;  ///< how far a step may differ from the usual one
  double line_mm = 0.05;     ///< how far a slice may stand off the line through all
  double tilt_deg = 0.5;     ///< how far a stated gantry tilt may differ from the positions'
};

/// Throws RefusedError naming files, values and limits: fewer than two positions, orientations or
/// sizes that differ, missing slices (their positions are listed), uneven spacing, slices off the
/// line, a stated gantry tilt that the positions do not show.
[[nodiscard]] SliceStack stack_slices(const std::vector<SliceGeometry>& slices,
                                      const SliceLimits& limits = {});

}  // namespace holdfast::registration
