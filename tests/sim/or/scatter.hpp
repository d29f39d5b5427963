// SPDX-License-Identifier: Apache-2.0
// What tissue and laser do to a projected pattern: subsurface scatter, and speckle.
#pragma once

#include <vector>

#include <opencv2/core.hpp>

#include "tests/sim/or/phantom.hpp"
#include "tests/sim/or/renderer.hpp"

namespace holdfast::sim {

/// Spreads the pattern's irradiance, surface by surface, by exp(-r / scatter_mm): light enters
/// where it falls and leaves nearby, within the same surface and in shadow too. Worked out in the
/// image, at the scale of the focal plane. `surface`: CV_16S, -1 for nothing.
void scatter_light(const std::vector<LitSurface>& surfaces, const RoomShot& shot, double px_per_mm,
                   const cv::Mat_<std::int16_t>& surface, cv::Mat_<float>& irradiance);

/// Fully developed speckle with grains of about 2 px. It depends on the pupil, so each camera sees
/// its own; it stands still as long as nothing moves.
class Speckle {
 public:
  /// Multiplies by 1 + contrast * (s - 1); s has mean 1 and a negative-exponential distribution.
  void apply(cv::Mat_<float>& irradiance, double contrast, cv::Point origin, bool is_right);

 private:
  static constexpr int kSize = 1024;  // repeats beyond
  cv::Mat_<float> fields_[2];
};

}  // namespace holdfast::sim
