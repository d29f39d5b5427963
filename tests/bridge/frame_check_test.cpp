// SPDX-License-Identifier: Apache-2.0
#include "bridge/frame_check.hpp"

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "rt/core/error.hpp"

namespace holdfast::bridge {
namespace {

using safety::Reason;

cv::Mat noisy(int type, double mean, std::uint64_t seed) {
  cv::Mat image(1080, 1920, type);
  cv::RNG random(seed);
  random.fill(image, cv::RNG::NORMAL, cv::Scalar::all(mean), cv::Scalar::all(mean / 60));
  return image;
}

TEST(FrameCheck, FindsNothingAgainstALiveImage) {
  FrameCheck check;
  EXPECT_TRUE(check.check(noisy(CV_8UC1, 120, 1)).empty());
  EXPECT_TRUE(check.check(noisy(CV_8UC1, 120, 2)).empty());
}

TEST(FrameCheck, TellsAnImageThatRepeatsBitForBit) {
  FrameCheck check;
  const cv::Mat image = noisy(CV_8UC1, 120, 1);
  EXPECT_FALSE(check.check(image).contains(Reason::frame_frozen));
  EXPECT_TRUE(check.check(image.clone()).contains(Reason::frame_frozen));
}

TEST(FrameCheck, OneChangedBitInALookedAtRowIsLife) {
  FrameCheck check;
  cv::Mat image = noisy(CV_8UC1, 120, 1);
  EXPECT_TRUE(check.check(image).empty());
  image.at<std::uint8_t>(8 * 67, 1917) ^= 1U;
  EXPECT_TRUE(check.check(image).empty());
}

TEST(FrameCheck, ForgetsThePreviousImageWhenTold) {
  FrameCheck check;
  const cv::Mat image = noisy(CV_8UC1, 120, 1);
  EXPECT_TRUE(check.check(image).empty());
  check.forget_previous();
  EXPECT_TRUE(check.check(image).empty());
}

TEST(FrameCheck, TellsDarkInEveryType) {
  for (const auto& [type, dark] : {std::pair{CV_8UC1, 3}, {CV_8UC3, 3}, {CV_16UC1, 3 * 16}}) {
    FrameCheck check;
    EXPECT_TRUE(check.check(noisy(type, dark, 1)).contains(Reason::frame_dark)) << type;
    EXPECT_FALSE(check.check(noisy(type, dark * 30, 1)).contains(Reason::frame_dark)) << type;
  }
}

TEST(FrameCheck, TellsSaturationJustBeyondItsFraction) {
  FrameCheckLimits limits;
  limits.saturated_fraction_max = 0.25;
  FrameCheck check(limits);
  cv::Mat image = noisy(CV_8UC1, 120, 1);
  image(cv::Rect(0, 0, 480, 1080)).setTo(255);
  EXPECT_FALSE(check.check(image).contains(Reason::frame_saturated));
  image(cv::Rect(0, 0, 482, 1080)).setTo(255);
  EXPECT_TRUE(check.check(image).contains(Reason::frame_saturated));
}

TEST(FrameCheck, AnEmptyOrForeignImageIsAFault) {
  FrameCheck check;
  EXPECT_TRUE(check.check(cv::Mat()).contains(Reason::internal_fault));
  EXPECT_TRUE(check.check(cv::Mat(8, 8, CV_32F, cv::Scalar(0))).contains(Reason::internal_fault));
}

TEST(FrameCheck, RefusesImpossibleLimits) {
  FrameCheckLimits limits;
  limits.dark_level = 256;
  EXPECT_THROW(FrameCheck{limits}, InputError);
  limits = {};
  limits.saturated_fraction_max = 1.5;
  EXPECT_THROW(FrameCheck{limits}, InputError);
}

}  // namespace
}  // namespace holdfast::bridge
