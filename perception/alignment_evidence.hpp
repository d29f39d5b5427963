// SPDX-License-Identifier: Apache-2.0
// What the rows of an alignment say of it: how well it fits, and how far from the truth it may be.
// For DirectAligner. Pure; allocation-free once `scratch` has room for a number a row.
#pragma once

#include <array>
#include <optional>
#include <vector>

#include <Eigen/Core>

#include "perception/direct_alignment.hpp"
#include "perception/patch_sighting.hpp"
#include "perception/tracker_parameters.hpp"

namespace holdfast::perception {

/// A sighting with its say in the normal equations. One whose `robust` is 0 has none.
struct AlignmentRow : PatchSighting {
  Eigen::Matrix2d weight;                // inverse covariance of the displacement
  Eigen::Vector2d residual;              // displacement left after the step
  Eigen::Matrix<double, 6, 1> gradient;  // -J^T W d
  std::array<double, 21> hessian;        // J^T W J, upper triangle by columns
  double trust, robust;
};

/// Of at least one value; reorders them.
[[nodiscard]] double median(std::vector<double>& values);

/// All but the sharpness. `noise` is what the images differ by, not yet what each has
/// (noise_of_both).
[[nodiscard]] AlignmentQuality quality_of(const std::vector<AlignmentRow>& rows,
                                          std::vector<double>& scratch);

/// The noise's variance, grey levels^2, behind a difference of `left` grey levels.
[[nodiscard]] double noise_of_both(double left);

/// Of the normal equations; planar motion has no tilt, and its rows and columns come out as zero.
/// None when some motion is not determined.
[[nodiscard]] std::optional<Matrix6d> inverse_of(const Matrix6d& H, Freedom freedom);

/// What stands behind the rows' errors.
struct ErrorModel {
  double noise2;  ///< grey levels^2
  const DirectParameters& direct;
  const UncertaintyParameters& uncertainty;
  Freedom freedom;
};

/// As MotionEstimate::covariance; none when some motion is not determined.
[[nodiscard]] std::optional<Matrix6d> covariance_of(const std::vector<AlignmentRow>& rows,
                                                    const ErrorModel& model);

}  // namespace holdfast::perception
