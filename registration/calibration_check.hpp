// SPDX-License-Identifier: Apache-2.0
// What a stereo calibration must fulfil before anything is measured with it.
#pragma once

#include <optional>
#include <string>

#include "registration/stereo_calibration.hpp"

namespace holdfast::registration {

/// Empty when the calibration may be used; otherwise one line with key, value and limit: sizes,
/// focal lengths, distortion that cannot be undone over the image, R no rotation, T no baseline,
/// covariance of the wrong size or not positive semi-definite, zooms not ascending.
[[nodiscard]] std::optional<std::string> invalid_calibration(const StereoCalibration& calibration);

/// One record; the text does not name the zoom.
[[nodiscard]] std::optional<std::string> invalid_zoom(const ZoomCalibration& zoom,
                                                      int image_width_px, int image_height_px);

}  // namespace holdfast::registration
