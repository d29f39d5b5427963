// SPDX-License-Identifier: Apache-2.0
// Zhang's calibration of one zoom, as OpenCV has it: where the bundle adjustment starts, and the
// plain recipe of paper A to compare with.
#pragma once

#include <vector>

#include <opencv2/core.hpp>

#include "registration/calibration_views.hpp"
#include "registration/stereo_calibration.hpp"

namespace holdfast::registration {

/// A rough but safe start: square pixels, principal point in the image's middle, one radial
/// coefficient; R and T as the median over the pairs. No covariance. At least 3 pairs; the result
/// may be nonsense where the views do not constrain it (judge it by what follows).
[[nodiscard]] ZoomCalibration start_of_zoom(const ZoomViews& views, const BoardPattern& board,
                                            int image_width_px, int image_height_px);

/// cv::calibrateCamera for each side, five coefficients, then cv::stereoCalibrate with the
/// intrinsics held (CALIB_FIX_INTRINSIC), all at their defaults. No covariance.
[[nodiscard]] ZoomCalibration plain_calibration(const ZoomViews& views, const BoardPattern& board,
                                                int image_width_px, int image_height_px);

/// Position of the right camera in the left camera's frame as this pair alone has it, mm: the
/// board's pose in one image against that in the other. Rough: a board's tilt is ambiguous in one
/// view at a long focal length; take the median of many.
[[nodiscard]] cv::Vec3d right_camera_mm(const BoardPair& pair, const BoardPattern& board,
                                        const ZoomCalibration& zoom);

}  // namespace holdfast::registration
