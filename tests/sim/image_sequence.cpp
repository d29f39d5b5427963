// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/image_sequence.hpp"

#include <algorithm>
#include <array>
#include <string>

#include <fmt/core.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/videoio.hpp>

#include "rt/core/error.hpp"

namespace holdfast::sim {
namespace {

using bridge::PixelFormat;

constexpr std::size_t kMemoryMax = std::size_t{4} << 30U;

bool is_image(const std::filesystem::path& path) {
  constexpr std::array<std::string_view, 6> kEndings{".png", ".tif",  ".tiff",
                                                     ".jpg", ".jpeg", ".bmp"};
  std::string ending = path.extension().string();
  std::transform(ending.begin(), ending.end(), ending.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return std::find(kEndings.begin(), kEndings.end(), ending) != kEndings.end();
}

class Frames {
 public:
  void add(cv::Mat image, const std::string& where) {
    if (image.empty()) throw InputError(fmt::format("{}: not a readable image", where));
    if (image.depth() == CV_16U) image.convertTo(image, CV_8U, 1.0 / 257);
    if (image.type() == CV_8UC4) cv::cvtColor(image, image, cv::COLOR_BGRA2BGR);
    if (image.type() != CV_8UC1 && image.type() != CV_8UC3)
      throw InputError(fmt::format("{}: neither grey nor colour of 8 or 16 bit", where));
    if (!list.empty() && image.size() != list.front().size())
      throw InputError(fmt::format("{}: {}x{} px, the first image has {}x{}", where, image.cols,
                                   image.rows, list.front().cols, list.front().rows));
    bytes_ += image.total() * image.elemSize();
    if (bytes_ > kMemoryMax)
      throw InputError(
          fmt::format("{}: the sequence needs more than {} MiB", where, kMemoryMax >> 20U));
    list.push_back(std::move(image));
  }
  std::vector<cv::Mat> list;

 private:
  std::size_t bytes_ = 0;
};

void mosaic(const cv::Mat& bgr, PixelFormat format, const cv::Rect& region, cv::Mat& out) {
  // Channel (BGR order) at even row/even column, even/odd, odd/even, odd/odd.
  static constexpr std::array<int, 4> kRg{2, 1, 1, 0}, kGb{1, 0, 2, 1}, kGr{1, 2, 0, 1},
      kBg{0, 1, 1, 2};
  const auto& channels = format == PixelFormat::bayer_rg8   ? kRg
                         : format == PixelFormat::bayer_gb8 ? kGb
                         : format == PixelFormat::bayer_gr8 ? kGr
                                                            : kBg;
  for (int y = 0; y < bgr.rows; ++y)
    for (int x = 0; x < bgr.cols; ++x) {
      const int cell = ((y + region.y) & 1) * 2 + ((x + region.x) & 1);
      out.at<std::uint8_t>(y, x) =
          bgr.at<cv::Vec3b>(y, x)[channels[static_cast<std::size_t>(cell)]];
    }
}

}  // namespace

ImageSequence::ImageSequence(const std::filesystem::path& path) {
  Frames frames;
  if (std::filesystem::is_directory(path)) {
    std::vector<std::filesystem::path> files;
    for (const auto& entry : std::filesystem::directory_iterator(path))
      if (entry.is_regular_file() && is_image(entry.path())) files.push_back(entry.path());
    std::sort(files.begin(), files.end());
    for (const auto& file : files)
      frames.add(cv::imread(file.string(), cv::IMREAD_UNCHANGED), file.string());
  } else {
    cv::VideoCapture video(path.string(), cv::CAP_FFMPEG);
    if (!video.isOpened()) throw InputError(fmt::format("{}: not a readable video", path.string()));
    for (cv::Mat image; video.read(image); image = cv::Mat()) frames.add(image, path.string());
  }
  if (frames.list.empty()) throw InputError(fmt::format("{}: no images", path.string()));
  frames_ = std::move(frames.list);
}

void ImageSequence::render(std::chrono::nanoseconds t_mid_exposure, const View& view,
                           PixelFormat format, const cv::Rect& region, std::uint8_t* pixels) {
  if (t_mid_exposure != t_last_ && t_last_.count() >= 0) next_ = (next_ + 1) % frames_.size();
  t_last_ = t_mid_exposure;
  cv::Mat image = frames_[next_](region).clone();
  if (view.is_dark) image.setTo(2);
  if (view.is_occluded) image.setTo(cv::Scalar::all(120));
  const bool is_colour = image.channels() == 3;
  const bool wants_grey = format == PixelFormat::mono8 || format == PixelFormat::mono12;
  if (is_colour && wants_grey) cv::cvtColor(image, image, cv::COLOR_BGR2GRAY);
  if (!is_colour && !wants_grey) cv::cvtColor(image, image, cv::COLOR_GRAY2BGR);
  const auto out = [&](int type) { return cv::Mat(region.size(), type, pixels); };
  cv::Mat wire;
  if (format == PixelFormat::mono8)
    image.copyTo(wire = out(CV_8UC1));
  else if (format == PixelFormat::mono12)
    image.convertTo(wire = out(CV_16UC1), CV_16U, 16);
  else if (format == PixelFormat::bgr8)
    image.copyTo(wire = out(CV_8UC3));
  else if (format == PixelFormat::rgb8)
    cv::cvtColor(image, wire = out(CV_8UC3), cv::COLOR_BGR2RGB);
  else
    mosaic(image, format, region, wire = out(CV_8UC1));
}

}  // namespace holdfast::sim
