// SPDX-License-Identifier: Apache-2.0
// Where reconstructions are judged: between the fiducials, away from the holders that carry them.
// Drawn from the CT's beads alone, so no person chooses it and no truth is needed.
#pragma once

#include <vector>

#include <Eigen/Core>

#include "registration/markups.hpp"

namespace holdfast::rt {

class FiducialRegion {
 public:
  /// At least three points (mm) that are not in a line, else InputError. `clearance_mm` around each
  /// is left out.
  explicit FiducialRegion(const registration::Markups& beads, double clearance_mm = 9);

  /// Whether the point, seen along the plane through the fiducials, is inside.
  [[nodiscard]] bool contains(const Eigen::Vector3d& p_ct_mm) const;
  [[nodiscard]] const Eigen::Vector3d& centre_mm() const noexcept { return centre_; }
  [[nodiscard]] const Eigen::Vector3d& normal() const noexcept { return axes_[2]; }

 private:
  [[nodiscard]] Eigen::Vector2d in_plane(const Eigen::Vector3d& p_ct_mm) const;
  Eigen::Vector3d centre_, axes_[3];
  std::vector<Eigen::Vector2d> corners_;  // around the centre, counter-clockwise
  double clearance_mm_;
};

}  // namespace holdfast::rt
