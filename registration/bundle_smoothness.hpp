// SPDX-License-Identifier: Apache-2.0
// Part of stereo_bundle: the parameters' smoothness over zoom, and how smooth the data show them.
#pragma once

#include <vector>

#include <Eigen/Core>
#include <ceres/problem.h>
#include <opencv2/core.hpp>

#include "registration/bundle_unknowns.hpp"
#include "registration/calibration_views.hpp"
#include "registration/stereo_bundle.hpp"

namespace holdfast::registration::bundle {

/// Orthonormal contrasts over the zooms (rows) that every parabola in log zoom annuls: as many
/// columns as there are zooms beyond three.
[[nodiscard]] Eigen::MatrixXd contrasts(const std::vector<ZoomViews>& views);

/// Loose: what a badly made zoom might do. One a parameter, in ZoomUnknowns::blocks()' order.
[[nodiscard]] Eigen::VectorXd first_smooth_sigma(const ZoomUnknowns& zoom, cv::Size image,
                                                 const BundleOptions& options);

/// What a parabola over zoom does not explain is 0 ± `sigma`.
void add_smoothness(ceres::Problem& problem, Unknowns& unknowns, const Eigen::MatrixXd& contrasts,
                    const Eigen::VectorXd& sigma);

/// One step of expectation maximisation on `sigma`, given the zooms and their covariance (blocks of
/// kOfZoom); returns the largest relative change.
double learn_smoothness(const std::vector<ZoomUnknowns>& zooms, const Eigen::MatrixXd& covariance,
                        const Eigen::MatrixXd& contrasts, Eigen::VectorXd& sigma);

}  // namespace holdfast::registration::bundle
