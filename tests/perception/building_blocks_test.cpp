// SPDX-License-Identifier: Apache-2.0
// The tracker's parts, each on its own: reflection mask, matcher, patch alignment, pose fit.
#include <limits>
#include <random>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "perception/matcher.hpp"
#include "perception/patch_alignment.hpp"
#include "perception/pose_fit.hpp"
#include "perception/reflection_mask.hpp"
#include "tests/perception/support/moving_scene.hpp"

namespace holdfast::perception {
namespace {

TEST(ReflectionMask, DropsWhatIsBrightAndUnsaturatedAndKeepsTheRest) {
  cv::Mat image(64, 200, CV_8UC3, cv::Scalar(70, 80, 90));
  const cv::Rect glint(10, 10, 20, 20), red(60, 10, 20, 20), dim(110, 10, 20, 20);
  image(glint).setTo(cv::Scalar(250, 252, 251));
  image(red).setTo(cv::Scalar(120, 230, 255));  // bright, but coloured
  image(dim).setTo(cv::Scalar(150, 150, 150));  // unsaturated, but not bright
  GreyAndMask out;
  make_grey_and_mask(image, ReflectionMaskParameters{}, out);
  EXPECT_EQ(out.keep_half.at<uchar>(10, 10), 0);
  EXPECT_EQ(out.keep_half.at<uchar>(10, 3), 0) << "not dilated";
  EXPECT_EQ(out.keep_half.at<uchar>(10, 35), 255);
  EXPECT_EQ(out.keep_half.at<uchar>(10, 60), 255);
  EXPECT_LT(cv::countNonZero(out.keep_half == 0), 16 * 16);
}

TEST(ReflectionMask, GreyImageAgreesWithOpenCvToOneLevelAtAnyWidth) {
  cv::RNG random(2);
  for (const int width : {2, 15, 31, 33, 64, 101}) {
    cv::Mat image(7, width, CV_8UC3), grey;
    random.fill(image, cv::RNG::UNIFORM, 0, 256);
    cv::cvtColor(image, grey, cv::COLOR_BGR2GRAY);
    GreyAndMask out;
    make_grey_and_mask(image, ReflectionMaskParameters{}, out);
    EXPECT_LE(cv::norm(out.grey, grey, cv::NORM_INF), 2) << width;
    EXPECT_EQ(out.half.size(), cv::Size(width / 2, 3));
  }
}

TEST(ReflectionMask, DimGreyFrameKeepsItsBrightestTexture) {
  cv::Mat image(64, 64, CV_8UC1, cv::Scalar(40));
  image(cv::Rect(20, 20, 10, 10)).setTo(120);
  GreyAndMask out;
  make_grey_and_mask(image, ReflectionMaskParameters{}, out);
  EXPECT_EQ(cv::countNonZero(out.keep_half), 32 * 32);
}

Features random_features(int count, unsigned seed) {
  std::mt19937_64 random(seed);
  Features features;
  for (int i = 0; i < count; ++i) {
    features.pixels.emplace_back(static_cast<float>(random() % 1000),
                                 static_cast<float>(random() % 1000));
    features.descriptors.push_back({random(), random(), random(), random()});
    features.strengths.push_back(1);
  }
  return features;
}

TEST(Matcher, FindsEveryCopyAndNothingInNoise) {
  const Features first = random_features(300, 1);
  Features second = first;
  for (Descriptor& d : second.descriptors) d[0] ^= 0x1111111111111111ULL;  // 16 bits differ
  const auto matches = match_all(first, second, MatchParameters{});
  ASSERT_EQ(matches.size(), 300U);
  for (const Match& match : matches) {
    EXPECT_EQ(match.first, match.second);
    EXPECT_EQ(match.distance, 16);
  }
  EXPECT_TRUE(match_all(first, random_features(300, 2), MatchParameters{}).empty());
  EXPECT_TRUE(match_all(first, Features{}, MatchParameters{}).empty());
}

TEST(Matcher, RefusesWhatLooksAlikeTwice) {
  const Features first = random_features(50, 1);
  Features second = first;
  second.pixels.insert(second.pixels.end(), first.pixels.begin(), first.pixels.end());
  second.descriptors.insert(second.descriptors.end(), first.descriptors.begin(),
                            first.descriptors.end());
  EXPECT_TRUE(match_all(first, second, MatchParameters{}).empty());
}

TEST(Matcher, GuidedSearchFindsTheSameAndOnlyWithinItsRadius) {
  const Features first = random_features(300, 1);
  std::vector<cv::Point2d> places(first.pixels.begin(), first.pixels.end());
  EXPECT_EQ(match_near(first, places, first, MatchParameters{}).size(), 300U);
  for (cv::Point2d& place : places) place.x += 65;
  EXPECT_TRUE(match_near(first, places, first, MatchParameters{}).empty());
  for (cv::Point2d& place : places) place.x = std::numeric_limits<double>::quiet_NaN();
  EXPECT_TRUE(match_near(first, places, first, MatchParameters{}).empty());
}

TEST(PatchAlignment, FindsAKnownSubPixelShift) {
  const CameraModel camera = test::microscope_camera(640, 480);
  const test::MovingScene scene(camera, test::photograph(), 200);
  const cv::Mat source = scene.image(Eigen::Isometry3d::Identity(), 0);
  const Eigen::Isometry3d T(Eigen::Translation3d(0.0268, -0.0166, 0));  // 1.34, -0.83 px
  const cv::Mat target = 0.8 * scene.image(T, 0) + 20;                  // another exposure, too
  int aligned = 0, near = 0;
  cv::Point2d sum;
  for (int y = 40; y < 440; y += 20)
    for (int x = 40; x < 600; x += 20) {
      const auto patch =
          align_patch(source, {x, y}, target, cv::Point2d(x, y), cv::Matx22d::eye(), 3);
      if (!patch || patch->zncc < 0.95) continue;
      ++aligned;
      const cv::Point2d error(patch->pixel.x - x - 1.34, patch->pixel.y - y + 0.83);
      sum += error;
      near += cv::norm(error) < 0.15 ? 1 : 0;
    }
  EXPECT_GT(aligned, 100);
  EXPECT_GT(near, 0.95 * aligned);  // 8-bit rounding moves the faintest patches further
  EXPECT_LT(cv::norm(sum) / aligned, 0.02);
}

TEST(PatchAlignment, RefusesFlatAndBorderPatches) {
  const cv::Mat flat(100, 100, CV_8UC1, cv::Scalar(80));
  EXPECT_FALSE(align_patch(flat, {50, 50}, flat, {50, 50}, cv::Matx22d::eye(), 3));
  cv::Mat noise(100, 100, CV_8UC1);
  cv::RNG random(1);
  random.fill(noise, cv::RNG::UNIFORM, 0, 256);
  for (const cv::Point p : {cv::Point(2, 50), cv::Point(50, 98), cv::Point(-5, 5)})
    EXPECT_FALSE(align_patch(noise, p, noise, cv::Point2d(p), cv::Matx22d::eye(), 3));
  EXPECT_FALSE(align_patch(noise, {50, 50}, noise, {1, 50}, cv::Matx22d::eye(), 3));
}

Observations observations(const Eigen::Isometry3d& T, double f_px, double noise_px,
                          double outlier_share, bool is_flat) {
  std::mt19937 random(4);
  std::uniform_real_distribution<double> side(-12, 12), depth(195, 205), share(0, 1);
  std::normal_distribution<double> normal(0, noise_px);
  Observations all;
  for (int i = 0; i < 300; ++i) {
    const Eigen::Vector3d p(side(random), side(random), is_flat ? 200 : depth(random));
    const Eigen::Vector3d q = T * p;
    Eigen::Vector2d seen =
        f_px * q.head<2>() / q.z() + Eigen::Vector2d(normal(random), normal(random));
    if (share(random) < outlier_share) seen = Eigen::Vector2d(60 * side(random), 60 * side(random));
    all.push_back({p, seen});
  }
  return all;
}

TEST(PoseFit, FindsAPlanarMotionAmongSixtyPercentOutliers) {
  Eigen::Isometry3d T(Eigen::Translation3d(1.5, -2, 3));
  T.rotate(Eigen::AngleAxisd(0.2, Eigen::Vector3d::UnitZ()));
  const FitSetup setup{10000, Freedom::planar, {0, 0, 200}};
  const auto all = observations(T, setup.f_px, 0.2, 0.6, true);
  const auto fit = find_consensus(all, setup, ConsensusParameters{});
  ASSERT_TRUE(fit);
  EXPECT_LT(
      (fit->T_camera_site * setup.p_pivot_site_mm - T * setup.p_pivot_site_mm).head<2>().norm(),
      0.001);
  EXPECT_GT(fit->inliers.size(), 100U);
}

TEST(PoseFit, FindsARigidMotionAmongFortyPercentOutliers) {
  Eigen::Isometry3d T(Eigen::Translation3d(0.5, -1, 2));
  T.rotate(Eigen::AngleAxisd(0.03, Eigen::Vector3d(1, 2, 2).normalized()));
  const Eigen::Vector3d pivot(0, 0, 200);
  T.translation() += pivot - T.linear() * pivot;
  const FitSetup setup{10000, Freedom::rigid, pivot};
  const auto fit =
      find_consensus(observations(T, setup.f_px, 0.2, 0.4, false), setup, ConsensusParameters{});
  ASSERT_TRUE(fit);
  EXPECT_LT(Eigen::AngleAxisd(fit->T_camera_site.linear() * T.linear().transpose()).angle(), 5e-4);
  EXPECT_LT((fit->T_camera_site * pivot - T * pivot).head<2>().norm(), 0.002);
}

TEST(PoseFit, FindsNothingInNoiseOrInTooFewPoints) {
  const FitSetup setup{10000, Freedom::planar, {0, 0, 200}};
  ConsensusParameters parameters;
  parameters.inliers_min = 20;
  EXPECT_FALSE(find_consensus(observations(Eigen::Isometry3d::Identity(), setup.f_px, 0.2, 1, true),
                              setup, parameters));
  EXPECT_FALSE(find_consensus({}, setup, parameters));
  EXPECT_FALSE(refine({}, setup, Eigen::Isometry3d::Identity(), 1));
}

TEST(PoseFit, CovarianceMatchesTheScatterOfManyFits) {
  std::mt19937 random(9);
  std::normal_distribution<double> noise(0, 0.3);
  const FitSetup setup{10000, Freedom::rigid, {0, 0, 200}};
  const Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  const auto clean = observations(T, setup.f_px, 0, 0, false);
  double chi2 = 0;
  constexpr int kRuns = 200;
  for (int run = 0; run < kRuns; ++run) {
    Observations noisy = clean;
    for (Observation& o : noisy) o.seen_px += Eigen::Vector2d(noise(random), noise(random));
    const auto fit = refine(noisy, setup, T, 2);
    ASSERT_TRUE(fit);
    EXPECT_NEAR(fit->sigma_px, 0.3, 0.06);
    Eigen::Matrix<double, 6, 1> error;
    const Eigen::AngleAxisd turn(fit->T_camera_site.linear());
    error << fit->T_camera_site * setup.p_pivot_site_mm - setup.p_pivot_site_mm,
        turn.angle() * turn.axis();
    const Matrix6d covariance = fit->sigma_px * fit->sigma_px * fit->unit_covariance;
    chi2 += error.dot(covariance.ldlt().solve(error));
  }
  EXPECT_NEAR(chi2 / kRuns, 6, 1.2);  // 6 +- 4 standard errors
}

}  // namespace
}  // namespace holdfast::perception
