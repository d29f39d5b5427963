// SPDX-License-Identifier: Apache-2.0
// From the pixels a camera sends to the images the rest of the house uses. Grey and BGR are passed
// through without a copy; RGB and Bayer are converted into one image allocated at the start.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string_view>

#include <opencv2/core.hpp>

#include "bridge/camera_source.hpp"

namespace holdfast::bridge {

/// The format's name in GenICam's Standard Features Naming Convention, e.g. "BayerRG8".
[[nodiscard]] std::string_view genicam_name(PixelFormat format) noexcept;

/// Bytes of one row of `width_px` pixels as the camera sends it, without padding.
[[nodiscard]] std::size_t row_bytes(PixelFormat format, int width_px) noexcept;

class PixelConversion {
 public:
  PixelConversion(PixelFormat format, int width_px, int height_px);

  /// `pixels`: height rows of row_bytes(), which stay the caller's. CV_8UC1 for mono8, CV_16UC1 for
  /// mono12 (0..4095, unscaled), CV_8UC3 BGR otherwise; valid until the pixels change or the next
  /// call. Allocates nothing. One thread at a time.
  [[nodiscard]] cv::Mat operator()(std::uint8_t* pixels);

 private:
  PixelFormat format_;
  int width_px_, height_px_;
  cv::Mat bgr_;
};

}  // namespace holdfast::bridge
