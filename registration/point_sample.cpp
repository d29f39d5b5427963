// SPDX-License-Identifier: Apache-2.0
#include "registration/point_sample.hpp"

#include <random>
#include <utility>

namespace holdfast::registration {

void draw(std::vector<Eigen::Vector3d>& points, std::size_t count, std::uint64_t seed) {
  if (count >= points.size()) return;
  // Fisher and Yates, with draws that do not depend on the standard library's distributions.
  std::mt19937_64 random{seed};
  for (std::size_t i = 0; i < count; ++i)
    std::swap(points[i], points[i + random() % (points.size() - i)]);
  points.resize(count);
}

}  // namespace holdfast::registration
