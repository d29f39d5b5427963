// SPDX-License-Identifier: Apache-2.0
#include "registration/calibration_views.hpp"

namespace holdfast::registration {

std::vector<Eigen::Vector3d> BoardPattern::points_mm() const {
  std::vector<Eigen::Vector3d> points;
  for (int r = 0; r < rows; ++r)
    for (int c = 0; c < columns; ++c)
      points.emplace_back((c - 0.5 * (columns - 1)) * square_mm, (r - 0.5 * (rows - 1)) * square_mm,
                          0);
  return points;
}

}  // namespace holdfast::registration
