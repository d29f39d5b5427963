// SPDX-License-Identifier: Apache-2.0
// A depth map: 32-bit float TIFF, mm, NaN where unknown.
#pragma once

#include <string>

#include <opencv2/core.hpp>

namespace holdfast::bridge {

/// CV_32FC1 of the size given. Throws InputError for anything else: unreadable, other type or size.
/// The values are the reader's to judge (perception::invalid_geometry).
[[nodiscard]] cv::Mat read_depth_file(const std::string& path, int width_px, int height_px);

/// Writes CV_32FC1, whole or not at all. Throws InputError.
void write_depth_file(const std::string& path, const cv::Mat& depth_mm);

}  // namespace holdfast::bridge
