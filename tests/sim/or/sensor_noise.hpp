// SPDX-License-Identifier: Apache-2.0
// From light to a camera's numbers.
#pragma once

#include <cstdint>

#include <opencv2/core.hpp>

#include "tests/sim/or/renderer.hpp"

namespace holdfast::sim {

/// `light` in DN of 255 with noise, rounded and clipped: CV_8U, or CV_16U at 12 bits (0..4095).
/// The noise of a pixel depends on `seed` and its place alone. All cores.
[[nodiscard]] cv::Mat exposed(const cv::Mat_<float>& light, const SensorParameters& sensor,
                              std::uint64_t seed);

}  // namespace holdfast::sim
