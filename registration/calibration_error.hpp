// SPDX-License-Identifier: Apache-2.0
// How good a calibration is, in pixels and in mm: on given views, and as its own covariance
// predicts it.
#pragma once

#include <vector>

#include <Eigen/Core>

#include "registration/calibration_views.hpp"
#include "registration/stereo_calibration.hpp"

namespace holdfast::registration {

struct ViewError {
  double reprojection_left_px = 0, reprojection_right_px = 0;  ///< rms over the corners
  double epipolar_px = 0;                                      ///< rms over the corners
  double board_mm = 0;  ///< triangulated corners against the board's shape, rigidly fitted, rms
};

/// The pair's errors under `zoom`: only the board's pose is fitted to it. `board_mm`: the corners'
/// places on the board (BoardPattern::points_mm, or the bent board of the bundle).
[[nodiscard]] ViewError view_error(const BoardPair& pair,
                                   const std::vector<Eigen::Vector3d>& board_mm,
                                   const ZoomCalibration& zoom);

/// Non-rigid error that the covariance of `zoom` predicts (1 sigma, rms over the working volume:
/// the images' overlap, from 0.9 to 1.1 times `depth_mm`): what a rigid registration cannot remove.
/// Infinite where it cannot be told (no covariance, nothing seen by both).
[[nodiscard]] double predicted_nonrigid_mm(const ZoomCalibration& zoom, int image_width_px,
                                           int image_height_px, double depth_mm);

/// By how much to multiply the covariances of `fold` (a fit that has not seen `held_out`, index by
/// index the same zooms) for them to explain its errors on these views; at least 1. The model's own
/// errors appear here; in the residuals of the fit itself they hide.
[[nodiscard]] double covariance_inflation(const std::vector<ZoomViews>& held_out,
                                          const std::vector<ZoomCalibration>& fold,
                                          const std::vector<Eigen::Vector3d>& board_mm,
                                          double corner_sigma_px);

}  // namespace holdfast::registration
