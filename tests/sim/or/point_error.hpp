// SPDX-License-Identifier: Apache-2.0
// Points that the pipeline measured, against where they truly are.
#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>

#include "registration/markups.hpp"

namespace holdfast::sim {

struct TruePoint {
  std::string label;
  Eigen::Vector3d p_mm;
};

struct PointError {
  struct Entry {
    std::string label;
    Eigen::Vector3d error_mm;   ///< measured less true
    double after_rigid_mm = 0;  ///< its length once a rigid motion is taken out; NaN below three
  };
  std::vector<Entry> points;
  double rms_mm = 0, max_mm = 0;
  double rms_after_rigid_mm = 0;  ///< NaN below three points
  int missing = 0, surplus = 0;
};

/// Pairs by the number at the end of the labels ("marker 3" is "3"), whichever way they are
/// ordered.
[[nodiscard]] PointError error_by_label(const std::vector<registration::MarkupPoint>& measured,
                                        const std::vector<TruePoint>& truth);

/// Pairs each true point with the nearest measured one, at most `reach_mm` away.
[[nodiscard]] PointError error_by_place(const std::vector<registration::MarkupPoint>& measured,
                                        const std::vector<TruePoint>& truth, double reach_mm);

/// The points `key` ("marker_camera", "bead_camera" ...) of pose `pose` of the truth that
/// `holdfast-sim or` wrote. Throws InputError when the file does not hold them.
[[nodiscard]] std::vector<TruePoint> true_points(const std::string& truth_file,
                                                 const std::string& key, int pose);

/// Every bead, frame ct, of the truth that `holdfast-sim ct` or `or` wrote. Throws likewise.
[[nodiscard]] std::vector<TruePoint> true_beads(const std::string& truth_file);

}  // namespace holdfast::sim
