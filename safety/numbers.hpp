// SPDX-License-Identifier: Apache-2.0
// What makes a number usable at all, and comparisons in which NaN never passes. Pure, noexcept,
// allocation-free.
#pragma once

#include <Eigen/Geometry>

#include "safety/gate.hpp"

namespace holdfast::safety {

/// How far R^T·R may be from the identity, per element.
inline constexpr double kRigidTolerance = 1e-6;

/// True when `T` is finite, its rotation orthonormal within `tolerance` and right-handed, and its
/// last row 0 0 0 1.
[[nodiscard]] bool is_rigid(const Eigen::Isometry3d& T,
                            double tolerance = kRigidTolerance) noexcept;

/// True when `covariance` is finite, symmetric, positive on the diagonal (zero: never filled in)
/// and positive semidefinite, the latter two up to rounding (1e-9 of its own scale).
[[nodiscard]] bool is_covariance(const Matrix6d& covariance) noexcept;

/// True when `value` is finite and not negative.
[[nodiscard]] bool is_magnitude(double value) noexcept;

/// Not (value <= limit): a NaN on either side exceeds.
[[nodiscard]] constexpr bool exceeds(double value, double limit) noexcept {
  return !(value <= limit);
}
/// Not (value >= limit): a NaN on either side falls short.
[[nodiscard]] constexpr bool falls_short(double value, double limit) noexcept {
  return !(value >= limit);
}

/// `to` - `from`, held at the end of the range instead of overflowing.
[[nodiscard]] Duration elapsed(Timestamp from, Timestamp to) noexcept;

}  // namespace holdfast::safety
