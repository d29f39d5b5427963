// SPDX-License-Identifier: Apache-2.0
#include "registration/spot_detection.hpp"

#include <cmath>

#include <gtest/gtest.h>

#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

constexpr double kX = 101.37, kY = 78.81;

struct Drawing {
  double x = kX, y = kY, height_grey = 120, radius_px = 4, slim = 1;
  double background_grey = 20, texture_grey = 0, noise_grey = 1.5;
};

/// A bell on a background with a texture, whose light it shares, noise and whole grey values.
cv::Mat1b draw(const Drawing& d, int seed = 1) {
  cv::Mat1b image(160, 200);
  cv::RNG random(static_cast<std::uint64_t>(seed));
  for (int v = 0; v < image.rows; ++v)
    for (int u = 0; u < image.cols; ++u) {
      const double dx = (u - d.x) / d.radius_px, dy = (v - d.y) / (d.slim * d.radius_px);
      const double texture = d.texture_grey * std::sin(0.31 * u + 0.2 * v) * std::cos(0.23 * v);
      image(v, u) = cv::saturate_cast<uchar>(d.background_grey + texture +
                                             d.height_grey * std::exp(-0.5 * (dx * dx + dy * dy)) +
                                             random.gaussian(d.noise_grey));
    }
  return image;
}

cv::Mat1b sum(const cv::Mat1b& a, const cv::Mat1b& b) {
  cv::Mat1b result;
  cv::add(a, b, result);
  return result;
}

void expect_refused(const cv::Mat1b& on, const cv::Mat1b& off, const std::string& part) {
  try {
    const ImageSpot spot = find_spot(on, off, "s03 (left)");
    FAIL() << part << ": found at " << spot.centre_px.transpose();
  } catch (const RefusedError& error) {
    EXPECT_NE(std::string(error.what()).find("s03 (left): "), std::string::npos) << error.what();
    EXPECT_NE(std::string(error.what()).find(part), std::string::npos) << error.what();
  }
}

TEST(SpotDetection, FindsTheCentreBelowAPixel) {
  double squares = 0, stated = 0;
  constexpr int kRuns = 20;
  for (int seed = 1; seed <= kRuns; ++seed) {
    const ImageSpot spot = find_spot(draw({}, seed), {}, "s");
    const Eigen::Vector2d error = spot.centre_px - Eigen::Vector2d(kX, kY);
    EXPECT_LT(error.norm(), 0.1);
    squares += error.squaredNorm() / kRuns;
    stated += spot.covariance_px2.trace() / kRuns;
    EXPECT_NEAR(spot.radius_px, 4, 0.2);
    EXPECT_NEAR(spot.contrast_grey, 120, 4);
  }
  EXPECT_LT(std::sqrt(squares), 0.03);
  EXPECT_GT(stated, squares) << "the stated error is not below the true one";
}

TEST(SpotDetection, TakesTheSurroundingsOffByTheImageWithoutTheBeam) {
  Drawing lit;
  lit.background_grey = 70;
  lit.texture_grey = 40;
  Drawing dark = lit;
  dark.height_grey = 0;
  const ImageSpot spot = find_spot(draw(lit, 2), draw(dark, 3), "s");
  EXPECT_LT((spot.centre_px - Eigen::Vector2d(kX, kY)).norm(), 0.1);
}

TEST(SpotDetection, IsLessSureOfASpotOnGrain) {
  cv::Mat1b on = draw({.noise_grey = 0.5});
  const double clean = find_spot(on, {}, "s").covariance_px2.trace();
  for (int v = 0; v < on.rows; ++v)  // speckle of 2 px
    for (int u = 0; u < on.cols; ++u)
      on(v, u) = cv::saturate_cast<uchar>(on(v, u) *
                                          (1 + 0.35 * ((u / 2 * 7 + v / 2 * 13) % 5 - 2) / 2.0));
  EXPECT_GT(find_spot(on, {}, "s").covariance_px2.trace(), 1.2 * clean);
}

TEST(SpotDetection, RefusesByName) {
  const cv::Mat1b dark = draw({.height_grey = 0});
  expect_refused(dark, {}, "no spot");
  expect_refused(dark, dark, "no spot");
  expect_refused(draw({.height_grey = 400}), {}, "saturated");
  expect_refused(draw({.x = 3}), {}, "cut off by the border");
  expect_refused(draw({.radius_px = 3, .slim = 7}), {}, "no round spot");
  expect_refused(draw({.radius_px = 30}), {}, "of the image");
  expect_refused(sum(draw({}), draw({.x = 40, .y = 60, .height_grey = 70, .background_grey = 0})),
                 {}, "two spots");
}

TEST(SpotDetection, RefusesAnotherSizeWithoutTheBeam) {
  EXPECT_THROW((void)find_spot(draw({}), cv::Mat1b(10, 10), "s"), InputError);
}

TEST(SpotDetection, ToleratesAFaintReflection) {
  const cv::Mat1b on =
      sum(draw({}), draw({.x = 40, .y = 60, .height_grey = 20, .background_grey = 0}));
  EXPECT_LT((find_spot(on, {}, "s").centre_px - Eigen::Vector2d(kX, kY)).norm(), 0.1);
}

}  // namespace
}  // namespace holdfast::registration
