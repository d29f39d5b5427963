// SPDX-License-Identifier: Apache-2.0
// From an image as OpenCV holds it to the bytes a camera of some format sends.
#pragma once

#include <cstdint>

#include <opencv2/core.hpp>

#include "bridge/camera_source.hpp"

namespace holdfast::sim {

/// Writes `image` (CV_8UC1 or BGR CV_8UC3; what lies in a region whose corner on the sensor is
/// `origin_px`) into `pixels`: rows without padding; mono12 as 16 bit little-endian, 8-bit values
/// times 16; a colour image becomes grey for a mono format, a grey one equal channels; the mosaic's
/// phase is the sensor's. `pixels` has row_bytes(format, cols) * rows bytes.
void write_wire_pixels(const cv::Mat& image, bridge::PixelFormat format, cv::Point origin_px,
                       std::uint8_t* pixels);

}  // namespace holdfast::sim
