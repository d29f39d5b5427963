// SPDX-License-Identifier: Apache-2.0
#include "bridge/pixel_conversion.hpp"

#include <utility>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

namespace holdfast::bridge {
namespace {

constexpr int kWidth = 64, kHeight = 32;

TEST(PixelConversion, KeepsTwelveBitsUnscaled) {
  std::vector<std::uint8_t> pixels(2 * kWidth * kHeight, 0);
  pixels[0] = 0xFF;
  pixels[1] = 0x0F;
  const cv::Mat image = PixelConversion(PixelFormat::mono12, kWidth, kHeight)(pixels.data());
  EXPECT_EQ(image.at<std::uint16_t>(0, 0), 4095);
  EXPECT_EQ(image.at<std::uint16_t>(0, 1), 0);
}

// A red scene under the mosaic named by its first two pixels.
TEST(PixelConversion, PutsRedInTheThirdChannel) {
  const std::pair<PixelFormat, std::pair<int, int>> red_at[] = {{PixelFormat::bayer_rg8, {0, 0}},
                                                                {PixelFormat::bayer_gr8, {0, 1}},
                                                                {PixelFormat::bayer_gb8, {1, 0}},
                                                                {PixelFormat::bayer_bg8, {1, 1}}};
  for (const auto& [format, place] : red_at) {
    std::vector<std::uint8_t> pixels(kWidth * kHeight, 0);
    for (int y = place.first; y < kHeight; y += 2)
      for (int x = place.second; x < kWidth; x += 2)
        pixels[static_cast<std::size_t>(y * kWidth + x)] = 200;
    PixelConversion convert(format, kWidth, kHeight);
    const cv::Vec3b centre = convert(pixels.data()).at<cv::Vec3b>(kHeight / 2, kWidth / 2);
    EXPECT_EQ(centre, cv::Vec3b(0, 0, 200)) << genicam_name(format);
  }
  std::vector<std::uint8_t> rgb(3 * kWidth * kHeight, 0);
  rgb[0] = 9;
  PixelConversion convert(PixelFormat::rgb8, kWidth, kHeight);
  EXPECT_EQ(convert(rgb.data()).at<cv::Vec3b>(0, 0), cv::Vec3b(0, 0, 9));
}

}  // namespace
}  // namespace holdfast::bridge
