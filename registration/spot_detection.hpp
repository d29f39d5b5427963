// SPDX-License-Identifier: Apache-2.0
// The spot of the robot's aiming beam in an image, to a fraction of a pixel. Pure, re-entrant.
#pragma once

#include <string>

#include <Eigen/Core>
#include <opencv2/core.hpp>

namespace holdfast::registration {

struct SpotLimits {
  double least_contrast_grey = 15;  ///< of the spot above its surroundings
  double least_contrast_sigma = 8;  ///< likewise, in standard deviations of the image's noise
  double rival_share = 0.3;         ///< a second one as bright as this part of the first refuses
  int saturated_grey = 250;         ///< the light that is missing here would move the centre
  int saturated_max_px = 4;         ///< pixels of the spot, hot ones of the sensor allowed for
  double largest_share = 0.02;      ///< of the image's area
  double slimmest = 0.3;            ///< its short axis against its long one
  double least_sigma_px = 0.05;     ///< what grain and glints of a real surface leave at best
};

struct ImageSpot {
  Eigen::Vector2d centre_px = Eigen::Vector2d::Zero();  ///< raw image, pixel centres at integers
  Eigen::Matrix2d covariance_px2 = Eigen::Matrix2d::Zero();
  double contrast_grey = 0;
  double radius_px = 0;  ///< standard deviation of its brightness about the centre
};

/// The one spot of `on`, less `off` (the same view without the beam, or empty: then nothing else in
/// the view may be bright). The centre is that of the Gaussian bell that fits best; its covariance
/// comes from what the fit leaves, their neighbours' likeness allowed for. Throws RefusedError
/// naming `name`, value and limit: no spot, two, saturated, cut off by the border, no round patch;
/// InputError when `off` differs from `on` in size.
[[nodiscard]] ImageSpot find_spot(const cv::Mat1b& on, const cv::Mat1b& off,
                                  const std::string& name, const SpotLimits& limits = {});

}  // namespace holdfast::registration
