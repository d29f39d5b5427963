// SPDX-License-Identifier: Apache-2.0
// One image file, read whole or refused. OpenCV fills what is missing of a truncated file with grey
// and goes on; a tracker must not see such a frame.
#pragma once

#include <string>

#include <opencv2/core.hpp>

namespace holdfast::bridge {

/// The image as stored (no conversion but colour to BGR). Throws InputError, naming the file, when
/// it is not there, no image, truncated (PNG, JPEG), or larger than 512 MiB.
/// One thread at a time: std::cerr is silenced during the decoding.
[[nodiscard]] cv::Mat read_image_file(const std::string& path);

}  // namespace holdfast::bridge
