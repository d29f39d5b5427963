// SPDX-License-Identifier: Apache-2.0
// From an implicit shape to what a light ray can meet: a mesh whose vertices lie on the shape, and
// relief on it that is finer than a CT scanner resolves.
#pragma once

#include <functional>

#include <Eigen/Geometry>

#include "tests/sim/or/phantom.hpp"

namespace holdfast::sim {

using ScalarField = std::function<float(const Eigen::Vector3f&)>;

/// The field's gradient, from the corners of a regular tetrahedron; error of second order.
[[nodiscard]] Eigen::Vector3f field_gradient(const ScalarField& field, const Eigen::Vector3f& p,
                                             float step_mm = 0.02F);

/// The surface `field` = 0 inside `box`: vertices about `spacing_mm` apart, moved onto the surface
/// along the gradient; normals along the gradient, which points outwards. Open where the surface
/// leaves the box. `is_distance`: the field changes by at most 1.5 a mm, which lets empty space be
/// skipped. Runs on all cores; the result does not depend on their number.
[[nodiscard]] LitSurface polygonise(const ScalarField& field, const Eigen::AlignedBox3f& box,
                                    float spacing_mm, bool is_distance);

/// Moves every vertex along its normal by `relief_mm` at it, and tilts the normals accordingly.
void add_relief(LitSurface& surface, const ScalarField& relief_mm);

/// Two octaves of noise, `width_mm` and a third of it wide, of about `sigma_um` in all.
[[nodiscard]] ScalarField fine_relief(float sigma_um, float width_mm, std::uint32_t seed);

/// Takes the surface into another frame.
void transform(LitSurface& surface, const Eigen::Isometry3d& T_to_from);

}  // namespace holdfast::sim
