// SPDX-License-Identifier: Apache-2.0
#include "bridge/image_file.hpp"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <sstream>
#include <streambuf>
#include <string_view>
#include <vector>

#include <opencv2/imgcodecs.hpp>

#include "rt/core/error.hpp"

namespace holdfast::bridge {
namespace {

constexpr std::uintmax_t kSizeMaxBytes = 512ULL * 1024 * 1024;

std::string read_bytes(const std::string& path) {
  std::error_code error;
  const auto size = std::filesystem::file_size(path, error);
  if (error) throw InputError(path + ": cannot be read: " + error.message());
  if (size > kSizeMaxBytes)
    throw InputError(path + ": is " + std::to_string(size) + " bytes, must be at most " +
                     std::to_string(kSizeMaxBytes));
  std::string bytes(size, '\0');
  std::ifstream file(path, std::ios::binary);
  file.read(bytes.data(), static_cast<std::streamsize>(size));
  if (!file || bytes.empty()) throw InputError(path + ": cannot be read, or is empty");
  return bytes;
}

/// PNG, JPEG, TIFF, BMP, PGM and PPM. OpenCV looks for many more, among them DICOM, whose library
/// ends the program over what it does not like.
bool is_of_known_format(std::string_view bytes) {
  constexpr std::string_view kBeginnings[] = {
      "\x89PNG\r\n", "\xff\xd8\xff", {"II*\0", 4}, {"MM\0*", 4}, "BM", "P2", "P3", "P5", "P6"};
  return std::any_of(std::begin(kBeginnings), std::end(kBeginnings),
                     [bytes](std::string_view beginning) { return bytes.starts_with(beginning); });
}

/// PNG and JPEG say where they end.
bool is_truncated(std::string_view bytes) {
  constexpr std::size_t kTrailerMax = 1024;
  const std::string_view tail = bytes.substr(bytes.size() - std::min(bytes.size(), kTrailerMax));
  if (bytes.substr(0, 4) == "\x89PNG") return tail.find("IEND") == std::string_view::npos;
  if (bytes.substr(0, 2) == "\xff\xd8") return tail.rfind("\xff\xd9") == std::string_view::npos;
  return false;
}

/// OpenCV reports what it cannot decode on std::cerr before it returns: the caller's one line of
/// error says it already.
class QuietErrors {
 public:
  QuietErrors() : usual_(std::cerr.rdbuf(sink_.rdbuf())) {}
  ~QuietErrors() { std::cerr.rdbuf(usual_); }
  QuietErrors(const QuietErrors&) = delete;
  QuietErrors& operator=(const QuietErrors&) = delete;

 private:
  std::ostringstream sink_;
  std::streambuf* usual_;
};

}  // namespace

cv::Mat read_image_file(const std::string& path) {
  std::string bytes = read_bytes(path);
  if (!is_of_known_format(bytes)) throw InputError(path + ": is not an image that can be decoded");
  if (is_truncated(bytes)) throw InputError(path + ": the image is truncated");
  const cv::Mat buffer(1, static_cast<int>(bytes.size()), CV_8UC1, bytes.data());
  cv::Mat image;
  const QuietErrors quiet;
  try {
    image = cv::imdecode(buffer, cv::IMREAD_UNCHANGED);
  } catch (const cv::Exception& e) {
    throw InputError(path + ": cannot be decoded: " + e.err);
  }
  if (image.empty()) throw InputError(path + ": is not an image that can be decoded");
  return image;
}

}  // namespace holdfast::bridge
