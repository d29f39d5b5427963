// SPDX-License-Identifier: Apache-2.0
// Part of stereo_bundle: how well the views determine the unknowns of the zooms.
#pragma once

#include <Eigen/Core>
#include <ceres/problem.h>

#include "registration/bundle_unknowns.hpp"
#include "registration/stereo_bundle.hpp"

namespace holdfast::registration::bundle {

/// Covariance of all zooms' unknowns, zoom by zoom in ZoomUnknowns::blocks()' order, poses and bend
/// marginalised; 0 where `options` hold a coefficient. `problem` is over `unknowns`.
[[nodiscard]] Eigen::MatrixXd zooms_covariance(ceres::Problem& problem, Unknowns& unknowns,
                                               const BundleOptions& options);

}  // namespace holdfast::registration::bundle
