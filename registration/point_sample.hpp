// SPDX-License-Identifier: Apache-2.0
// A random part of a point set, the same on every machine.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

namespace holdfast::registration {

/// Leaves `count` points, drawn without replacement; all, if there are no more.
void draw(std::vector<Eigen::Vector3d>& points, std::size_t count, std::uint64_t seed);

}  // namespace holdfast::registration
