// SPDX-License-Identifier: Apache-2.0
// The point spread of the lens, by depth.
#pragma once

#include <opencv2/core.hpp>

namespace holdfast::sim {

/// Convolves with a round Gaussian, border repeated; in place allowed. All cores.
void gaussian_blur(const cv::Mat_<float>& in, double sigma_px, cv::Mat_<float>& out);

/// Blurs `light` by a Gaussian of `variance` (px^2, per pixel): mixed from a few stages so that the
/// variance is exact. `scratch` keeps its memory from call to call.
struct PointSpreadScratch {
  cv::Mat_<float> stages[6];
};
void spread(cv::Mat_<float>& light, const cv::Mat_<float>& variance, double variance_min,
            double variance_max, PointSpreadScratch& scratch);

}  // namespace holdfast::sim
