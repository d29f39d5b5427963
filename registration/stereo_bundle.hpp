// SPDX-License-Identifier: Apache-2.0
// Bundle adjustment of a stereo camera over all its zooms at once: intrinsics, distortion, R and T
// of every zoom, the board's pose in every pair, and the board's own bend. The parameters vary
// smoothly with zoom, as an optical design does; how exactly is learnt from the data: each
// parameter is a parabola in log zoom plus a deviation whose size is estimated with it (empirical
// Bayes), so that a zoom that seats badly is not forced into line.
#pragma once

#include <vector>

#include <Eigen/Core>

#include "registration/calibration_views.hpp"
#include "registration/stereo_calibration.hpp"

namespace holdfast::registration {

struct BundleOptions {
  int coefficients = 12;            ///< of the distortion, as OpenCV counts: 5, or 12 (k4..k6 zero)
  bool is_joint = true;             ///< smooth over zoom and one bent board; false: each zoom alone
  double outlier_sigma = 3;         ///< Huber's bound, in standard deviations of a corner
  double distortion_prior_px = 30;  ///< how far a coefficient may move the image's corner (1 sigma)
  /// Likewise a coefficient of the thin prism. Lenses are turned and have little of it, and
  /// together with the principal point it looks almost as a turn of the camera: free, it lets the
  /// camera wander by millimetres.
  double prism_prior_px = 0.1;
  double bend_prior_mm = 0.05;  ///< the board's bend at its edge (1 sigma)
};

/// What the data taught about the noise: a fit of part of the views may take it over.
struct BundleNoise {
  double corner_sigma_px = 0;    ///< estimated noise of one coordinate of one corner
  Eigen::VectorXd smooth_sigma;  ///< deviation from smoothness of each parameter of a zoom
};

struct BundleResult {
  bool has_converged = false;
  std::vector<ZoomCalibration> zooms;  ///< in the order given; with covariance
  BundleNoise noise;
  Eigen::Vector3d bend_mm = Eigen::Vector3d::Zero();  ///< z = b0·u² + b1·u·v + b2·v², u, v in -1..1
  std::vector<Eigen::Vector3d> board_mm;              ///< the corners on the bent board
};

/// `start`: one record a zoom (same order as `views`), near enough to converge from. Every zoom
/// needs at least 3 pairs. `known`: the noise is taken from it instead of learnt (may be null).
/// Deterministic; one thread.
[[nodiscard]] BundleResult adjust_bundle(const std::vector<ZoomViews>& views,
                                         const BoardPattern& board,
                                         const std::vector<ZoomCalibration>& start,
                                         int image_width_px, int image_height_px,
                                         const BundleOptions& options,
                                         const BundleNoise* known = nullptr);

}  // namespace holdfast::registration
