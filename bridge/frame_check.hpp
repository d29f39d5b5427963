// SPDX-License-Identifier: Apache-2.0
// What can be said against an image before anything is tracked in it: that it repeats bit for bit,
// is dark, or is saturated. Looks at every eighth row, whole: a live sensor's noise changes some
// bit of those rows in every frame.
#pragma once

#include <cstdint>
#include <optional>

#include <opencv2/core.hpp>

#include "safety/reason.hpp"

namespace holdfast::bridge {

struct FrameCheckLimits {
  int dark_level = 12;                   ///< a sample at or below this, of 255, is dark
  double dark_fraction_max = 0.95;       ///< more dark samples than this: frame_dark
  int saturated_level = 250;             ///< a sample at or above this, of 255, is saturated
  double saturated_fraction_max = 0.30;  ///< more saturated samples than this: frame_saturated
};

class FrameCheck {
 public:
  /// Throws InputError when a level is outside 0..255 or a fraction outside 0..1.
  explicit FrameCheck(const FrameCheckLimits& limits = {});

  /// `image`: CV_8UC1, CV_8UC3, or CV_16UC1 with 12 significant bits. The subset of {frame_frozen,
  /// frame_dark, frame_saturated} that holds; internal_fault for an empty image or another type.
  /// frame_frozen compares with the image of the call before. No heap, no lock. One thread.
  [[nodiscard]] safety::ReasonSet check(const cv::Mat& image) noexcept;

  /// The next image is the first (after a reconnect: the stream may restart with the last image).
  void forget_previous() noexcept { previous_.reset(); }

 private:
  FrameCheckLimits limits_;
  std::optional<std::uint64_t> previous_;
};

}  // namespace holdfast::bridge
