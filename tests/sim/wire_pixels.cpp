// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/wire_pixels.hpp"

#include <array>

#include <opencv2/imgproc.hpp>

namespace holdfast::sim {
namespace {

using bridge::PixelFormat;

void mosaic(const cv::Mat& bgr, PixelFormat format, cv::Point origin_px, cv::Mat& out) {
  // Channel (BGR order) at even row/even column, even/odd, odd/even, odd/odd.
  static constexpr std::array<int, 4> kRg{2, 1, 1, 0}, kGb{1, 0, 2, 1}, kGr{1, 2, 0, 1},
      kBg{0, 1, 1, 2};
  const auto& channels = format == PixelFormat::bayer_rg8   ? kRg
                         : format == PixelFormat::bayer_gb8 ? kGb
                         : format == PixelFormat::bayer_gr8 ? kGr
                                                            : kBg;
  for (int y = 0; y < bgr.rows; ++y)
    for (int x = 0; x < bgr.cols; ++x) {
      const int cell = ((y + origin_px.y) & 1) * 2 + ((x + origin_px.x) & 1);
      out.at<std::uint8_t>(y, x) =
          bgr.at<cv::Vec3b>(y, x)[channels[static_cast<std::size_t>(cell)]];
    }
}

}  // namespace

void write_wire_pixels(const cv::Mat& image, PixelFormat format, cv::Point origin_px,
                       std::uint8_t* pixels) {
  const bool is_colour = image.channels() == 3;
  const bool wants_grey = format == PixelFormat::mono8 || format == PixelFormat::mono12;
  cv::Mat converted = image;
  if (is_colour && wants_grey) cv::cvtColor(image, converted, cv::COLOR_BGR2GRAY);
  if (!is_colour && !wants_grey) cv::cvtColor(image, converted, cv::COLOR_GRAY2BGR);
  const auto out = [&](int type) { return cv::Mat(image.size(), type, pixels); };
  cv::Mat wire;
  if (format == PixelFormat::mono8)
    converted.copyTo(wire = out(CV_8UC1));
  else if (format == PixelFormat::mono12)
    converted.convertTo(wire = out(CV_16UC1), CV_16U, 16);
  else if (format == PixelFormat::bgr8)
    converted.copyTo(wire = out(CV_8UC3));
  else if (format == PixelFormat::rgb8)
    cv::cvtColor(converted, wire = out(CV_8UC3), cv::COLOR_BGR2RGB);
  else
    mosaic(converted, format, origin_px, wire = out(CV_8UC1));
}

}  // namespace holdfast::sim
