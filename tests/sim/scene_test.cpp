// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/scene.hpp"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "rt/core/error.hpp"

namespace holdfast::sim {
namespace {

using bridge::PixelFormat;

SceneParameters small() {
  SceneParameters parameters;
  parameters.width_px = 320;
  parameters.height_px = 240;
  parameters.margin_mm = 3;
  return parameters;
}

cv::Mat mono12(Scene& scene, const SitePose& pose, const cv::Rect& region, bool has_noise = false) {
  cv::Mat image(region.size(), CV_16UC1);
  View view;
  view.has_noise = has_noise;
  scene.render(pose, view, PixelFormat::mono12, region, image.data);
  return image;
}

constexpr double kPixelMm = 0.02;
const cv::Rect kWhole(0, 0, 320, 240);

TEST(Scene, MovingTheSiteRightByPixelsMovesItsImageRight) {
  Scene scene(small());
  SitePose moved;
  moved.t_mm = {7 * kPixelMm, -3 * kPixelMm, 0};
  const cv::Mat before = mono12(scene, {}, kWhole), after = mono12(scene, moved, kWhole);
  const cv::Mat from = before(cv::Rect(10, 10, 200, 200)), to = after(cv::Rect(17, 7, 200, 200));
  EXPECT_LE(cv::norm(from, to, cv::NORM_INF), 1);
}

// Two different ways to compute the same surface: shared weights, and sixteen taps a pixel.
TEST(Scene, FastAndGeneralPathAgreeAtSubPixelPoses) {
  Scene scene(small());
  SitePose fast, general;
  fast.t_mm = {0.1237, -0.0719, 0};
  general.t_mm = fast.t_mm;
  general.q = Eigen::Quaterniond(Eigen::AngleAxisd(1e-13, Eigen::Vector3d::UnitZ()));
  general.t_mm.z() = 1e-10;
  EXPECT_LE(cv::norm(mono12(scene, fast, kWhole), mono12(scene, general, kWhole), cv::NORM_INF), 1);
}

TEST(Scene, MovingAwayShrinksTheImageAboutThePrincipalPoint) {
  Scene scene(small());
  SitePose away;
  away.t_mm = {0, 0, 200};  // twice the distance: half the size
  const cv::Mat near = mono12(scene, {}, kWhole), far = mono12(scene, away, kWhole);
  // far(c + d) = near(c + 2 d), c the principal point (159.5, 119.5): d = 20.5 -> 180, 200.5: no
  // common grid. d = 0.5 -> far 160, near 160.5: compare the mean of near's neighbours.
  const double expected = (near.at<std::uint16_t>(120, 160) + near.at<std::uint16_t>(120, 161) +
                           near.at<std::uint16_t>(121, 160) + near.at<std::uint16_t>(121, 161)) /
                          4.0;
  EXPECT_NEAR(far.at<std::uint16_t>(120, 160), expected, 80);
}

TEST(Scene, ARegionIsACutOfTheWhole) {
  Scene scene(small());
  SitePose pose;
  pose.t_mm = {0.0333, 0.0111, 0};
  const cv::Rect region(32, 16, 128, 64);
  EXPECT_EQ(
      cv::norm(mono12(scene, pose, kWhole)(region), mono12(scene, pose, region), cv::NORM_INF), 0);
}

TEST(Scene, NoiseHasTheStatedStrengthAndDiffersFromFrameToFrame) {
  Scene scene(small());
  cv::Mat clean, one, two;
  mono12(scene, {}, kWhole).convertTo(clean, CV_64F, 1.0 / 16);
  mono12(scene, {}, kWhole, true).convertTo(one, CV_64F, 1.0 / 16);
  mono12(scene, {}, kWhole, true).convertTo(two, CV_64F, 1.0 / 16);
  EXPECT_GT(cv::norm(one, two, cv::NORM_INF), 1);
  cv::Scalar mean, deviation;
  cv::meanStdDev(one - clean, mean, deviation);
  EXPECT_NEAR(mean[0], 0, 0.05);
  EXPECT_NEAR(deviation[0], std::sqrt(1.2 * 1.2 + 0.12 * 0.12 * cv::mean(clean)[0]), 0.05);
}

TEST(Scene, SameSeedSameBytes) {
  Scene one(small()), two(small());
  SceneParameters other = small();
  other.seed = 2;
  Scene three(other);
  EXPECT_EQ(cv::norm(mono12(one, {}, kWhole, true), mono12(two, {}, kWhole, true), cv::NORM_INF),
            0);
  EXPECT_GT(cv::norm(mono12(one, {}, kWhole), mono12(three, {}, kWhole), cv::NORM_INF), 100);
}

TEST(Scene, TheHandDoesNotMoveWithTheSite) {
  Scene scene(small());
  View occluded;
  occluded.is_occluded = true;
  occluded.has_noise = false;
  SitePose moved;
  moved.t_mm = {0.5, 0.3, 0};
  cv::Mat before(240, 320, CV_8UC1), after(240, 320, CV_8UC1);
  scene.render({}, occluded, PixelFormat::mono8, kWhole, before.data);
  scene.render(moved, occluded, PixelFormat::mono8, kWhole, after.data);
  const double same = cv::countNonZero(before == after) / (320.0 * 240);
  EXPECT_GT(same, 0.7);
  EXPECT_LT(same, 0.98);
}

TEST(Scene, RefusesImpossibleParameters) {
  SceneParameters parameters = small();
  parameters.depth_mm = 0;
  EXPECT_THROW(Scene{parameters}, InputError);
}

}  // namespace
}  // namespace holdfast::sim
