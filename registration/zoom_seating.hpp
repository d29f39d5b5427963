// SPDX-License-Identifier: Apache-2.0
// A zoom's optics come to rest a little differently each time: the images shift by a fraction of a
// pixel, each camera's on its own. Nothing says so but the images themselves.
#pragma once

#include <vector>

#include "registration/stereo_calibration.hpp"

namespace holdfast::registration {

/// Repeatability of a principal point (1 sigma, px, each of x and y) as the calibrated zooms show
/// it: where the right camera sees, in y, what lies in the middle of the left image is known to a
/// hundredth of a pixel, varies smoothly with zoom by design, and jumps by the seating of both.
/// Zooms are few: `expected_px` counts as much as four of them. Fewer than four zooms: that alone.
[[nodiscard]] double learnt_seating_px(const std::vector<ZoomCalibration>& zooms,
                                       int image_width_px, int image_height_px, double expected_px);

}  // namespace holdfast::registration
