// SPDX-License-Identifier: Apache-2.0
#include "rt/study/study_files.hpp"

#include <vector>

#include <fmt/format.h>
#include <opencv2/imgcodecs.hpp>

#include "bridge/atomic_file.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {

void make_folder(const std::filesystem::path& path) {
  std::error_code error;
  std::filesystem::create_directories(path, error);
  if (error)
    throw InputError(fmt::format("{}: cannot be made: {}", path.string(), error.message()));
}

void write_png(const std::filesystem::path& path, const cv::Mat& image) {
  std::vector<uchar> bytes;
  cv::imencode(".png", image, bytes);
  bridge::write_file_atomically(path.string(),
                                {reinterpret_cast<const char*>(bytes.data()), bytes.size()});
}

}  // namespace holdfast::rt
