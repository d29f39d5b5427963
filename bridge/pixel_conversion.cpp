// SPDX-License-Identifier: Apache-2.0
#include "bridge/pixel_conversion.hpp"

#include <opencv2/imgproc.hpp>

namespace holdfast::bridge {
namespace {

bool is_passed_through(PixelFormat format) {
  return format == PixelFormat::mono8 || format == PixelFormat::mono12 ||
         format == PixelFormat::bgr8;
}

int wire_type(PixelFormat format) {
  switch (format) {
    case PixelFormat::mono12:
      return CV_16UC1;
    case PixelFormat::rgb8:
    case PixelFormat::bgr8:
      return CV_8UC3;
    default:
      return CV_8UC1;
  }
}

// OpenCV names a mosaic by the second row's second and third pixel, GenICam by the first row's
// first two; the four-letter aliases agree with GenICam.
int conversion_code(PixelFormat format) {
  switch (format) {
    case PixelFormat::bayer_rg8:
      return cv::COLOR_BayerRGGB2BGR;
    case PixelFormat::bayer_gb8:
      return cv::COLOR_BayerGBRG2BGR;
    case PixelFormat::bayer_gr8:
      return cv::COLOR_BayerGRBG2BGR;
    case PixelFormat::bayer_bg8:
      return cv::COLOR_BayerBGGR2BGR;
    default:
      return cv::COLOR_RGB2BGR;
  }
}

}  // namespace

std::string_view genicam_name(PixelFormat format) noexcept {
  switch (format) {
    case PixelFormat::mono8:
      return "Mono8";
    case PixelFormat::mono12:
      return "Mono12";
    case PixelFormat::bayer_rg8:
      return "BayerRG8";
    case PixelFormat::bayer_gb8:
      return "BayerGB8";
    case PixelFormat::bayer_gr8:
      return "BayerGR8";
    case PixelFormat::bayer_bg8:
      return "BayerBG8";
    case PixelFormat::rgb8:
      return "RGB8";
    case PixelFormat::bgr8:
      return "BGR8";
  }
  return "unknown";
}

std::size_t row_bytes(PixelFormat format, int width_px) noexcept {
  return static_cast<std::size_t>(width_px) *
         static_cast<std::size_t>(CV_ELEM_SIZE(wire_type(format)));
}

PixelConversion::PixelConversion(PixelFormat format, int width_px, int height_px)
    : format_(format), width_px_(width_px), height_px_(height_px) {
  if (!is_passed_through(format)) bgr_ = cv::Mat::zeros(height_px, width_px, CV_8UC3);
}

cv::Mat PixelConversion::operator()(std::uint8_t* pixels) {
  cv::Mat wire(height_px_, width_px_, wire_type(format_), pixels);
  if (is_passed_through(format_)) return wire;
  cv::cvtColor(wire, bgr_, conversion_code(format_));
  return bgr_;
}

}  // namespace holdfast::bridge
