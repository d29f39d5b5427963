// SPDX-License-Identifier: Apache-2.0
#include "registration/ct/ct_volume.hpp"

#include <algorithm>
#include <cmath>

namespace holdfast::registration {

Eigen::Vector3d CtVolume::point_at(const Eigen::Vector3d& index) const {
  const double last = static_cast<double>(slice_origin_mm.size()) - 2;
  const double below = std::clamp(std::floor(index.z()), 0.0, last);
  const auto k = static_cast<std::size_t>(below);
  const Eigen::Vector3d step = slice_origin_mm[k + 1] - slice_origin_mm[k];
  return slice_origin_mm[k] + (index.z() - below) * step + index.x() * column_step_mm +
         index.y() * row_step_mm;
}

Eigen::Affine3d CtVolume::ct_from_index() const {
  const auto n = static_cast<double>(slice_origin_mm.size());
  Eigen::Vector3d mean = Eigen::Vector3d::Zero(), step = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& origin : slice_origin_mm) mean += origin / n;
  double k = 0, weights = 0;
  for (const Eigen::Vector3d& origin : slice_origin_mm) {
    const double from_middle = k++ - (n - 1) / 2;
    step += from_middle * (origin - mean);
    weights += from_middle * from_middle;
  }
  Eigen::Affine3d affine = Eigen::Affine3d::Identity();
  affine.linear() << column_step_mm, row_step_mm, step / weights;
  affine.translation() = mean - (n - 1) / 2 * affine.linear().col(2);
  return affine;
}

}  // namespace holdfast::registration
