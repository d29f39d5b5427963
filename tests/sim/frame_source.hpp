// SPDX-License-Identifier: Apache-2.0
// Where the virtual camera's pixels come from.
#pragma once

#include <chrono>
#include <cstdint>

#include <opencv2/core.hpp>

#include "bridge/camera_source.hpp"

namespace holdfast::sim {

/// What is wrong with the view, if anything.
struct View {
  bool is_occluded = false;  ///< a gloved hand, at rest in the camera's frame, over most of it
  bool is_dark = false;      ///< no light: read noise only
  bool has_noise = true;
};

class FrameSource {
 public:
  FrameSource() = default;
  virtual ~FrameSource() = default;
  FrameSource(const FrameSource&) = delete;
  FrameSource& operator=(const FrameSource&) = delete;

  [[nodiscard]] virtual cv::Size sensor_px() const noexcept = 0;
  /// Writes the `region` of the sensor as exposed around `t_mid_exposure` (CLOCK_MONOTONIC), in the
  /// layout a camera of this format sends (rows without padding; mono12 as 16 bit little-endian,
  /// 0..4095). One thread at a time.
  virtual void render(std::chrono::nanoseconds t_mid_exposure, const View& view,
                      bridge::PixelFormat format, const cv::Rect& region, std::uint8_t* pixels) = 0;
};

}  // namespace holdfast::sim
