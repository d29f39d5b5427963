// SPDX-License-Identifier: Apache-2.0
// Image files as the commands that measure in them want them.
#pragma once

#include <string>

#include <opencv2/core.hpp>

namespace holdfast::rt {

/// 8-bit grey; colour is turned grey, 16 bit scaled so that the brightest pixel is 255. Throws
/// InputError naming the file: unreadable, or another kind of pixel.
[[nodiscard]] cv::Mat read_grey_image(const std::string& path);

}  // namespace holdfast::rt
