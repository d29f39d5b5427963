// SPDX-License-Identifier: Apache-2.0
// What the studies write.
#pragma once

#include <filesystem>

#include <opencv2/core.hpp>

namespace holdfast::rt {

/// With its parents; nothing when it is there. Throws InputError when it cannot be made.
void make_folder(const std::filesystem::path& path);
/// Whole or not at all. Throws InputError.
void write_png(const std::filesystem::path& path, const cv::Mat& image);

}  // namespace holdfast::rt
