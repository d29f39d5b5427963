// SPDX-License-Identifier: Apache-2.0
// A small scene for tests of the optics: a bumpy plate of 100 x 70 mm with a post, whose shape is
// a formula, and four ArUco plates on it. It has no CT side.
#pragma once

#include "tests/sim/or/phantom.hpp"

namespace holdfast::sim {

[[nodiscard]] Phantom make_relief_phantom(std::uint32_t seed);

/// A flat white plate (frame ct: z = 0, facing +z) with black discs at `centres_mm`, for tests of
/// sub-pixel places.
[[nodiscard]] LitSurface make_dot_plate(const std::vector<Eigen::Vector2d>& centres_mm,
                                        double diameter_mm, double half_size_mm);

}  // namespace holdfast::sim
