// SPDX-License-Identifier: Apache-2.0
// Part of stereo_bundle: what is believed of a camera and of the board before any image is seen.
#pragma once

#include <vector>

#include <ceres/problem.h>
#include <opencv2/core.hpp>

#include "registration/bundle_unknowns.hpp"
#include "registration/stereo_bundle.hpp"

namespace holdfast::registration::bundle {

/// Of one block of unknowns, each on its own: mean, and 1 sigma.
struct Prior {
  std::vector<double> mean, sigma;
};

/// Of a camera whose focal length is about that of `camera`.
[[nodiscard]] Prior camera_prior(const Camera& camera, cv::Size image,
                                 const BundleOptions& options);

/// Of all cameras and the bend; holds what `options` say is not sought.
void add_priors(ceres::Problem& problem, Unknowns& unknowns, cv::Size image,
                const BundleOptions& options);

}  // namespace holdfast::registration::bundle
