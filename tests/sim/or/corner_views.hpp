// SPDX-License-Identifier: Apache-2.0
// Calibration without rendering: the board's corners projected through the true optics, with a
// given noise, posed and seated as `holdfast-sim or --what calibration` does.
#pragma once

#include <vector>

#include "registration/calibration_run.hpp"
#include "tests/sim/or/room.hpp"

namespace holdfast::sim {

/// Corners of every zoom's views; `noise_px` of each coordinate (1 sigma).
[[nodiscard]] std::vector<registration::ZoomViews> corner_views(const RoomConfig& config,
                                                                double noise_px);

/// What calibrate_stereo() makes of them; the board in `options` is replaced by the room's. Throws
/// as it does.
[[nodiscard]] registration::CalibrationOutcome calibrated_by_corners(
    const RoomConfig& config, double noise_px, registration::CalibrationOptions options);

}  // namespace holdfast::sim
