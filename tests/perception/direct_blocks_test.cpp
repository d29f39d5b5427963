// SPDX-License-Identifier: Apache-2.0
// Direct tracking's parts, each on its own: projection, pyramid, patch sums.
#include <random>

#include <gtest/gtest.h>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "perception/direct_template.hpp"
#include "perception/patch_kernel.hpp"
#include "perception/projection.hpp"
#include "perception/pyramid.hpp"
#include "perception/reflection_mask.hpp"

namespace holdfast::perception {
namespace {

class ProjectorAgainstOpenCv : public ::testing::TestWithParam<int> {};

TEST_P(ProjectorAgainstOpenCv, SamePixelsAndDerivativesForEveryNumberOfCoefficients) {
  CameraModel camera;
  camera.width_px = 1920;
  camera.height_px = 1080;
  camera.fx_px = 2100;
  camera.fy_px = 2050;
  camera.cx_px = 970;
  camera.cy_px = 530;
  const double all[] = {-0.2, 0.1,   0.002, -0.003, 0.05,  0.1,  -0.05,
                        0.02, 0.003, 0.001, -0.002, 0.004, 0.02, -0.03};
  camera.distortion = cv::Mat(1, GetParam(), CV_64F);
  for (int i = 0; i < GetParam(); ++i) camera.distortion.at<double>(i) = all[i];
  const Projector projector(camera);
  const cv::Matx33d K(camera.fx_px, 0, camera.cx_px, 0, camera.fy_px, camera.cy_px, 0, 0, 1);
  for (const Eigen::Vector3d& p :
       {Eigen::Vector3d(10, -20, 200), Eigen::Vector3d(-70, 30, 220), Eigen::Vector3d(0, 0, 150)}) {
    std::vector<cv::Point2d> seen;
    cv::projectPoints(std::vector<cv::Point3d>{{p.x(), p.y(), p.z()}}, cv::Vec3d(), cv::Vec3d(), K,
                      camera.distortion, seen);
    const Projection ours = projector.project(p);
    EXPECT_NEAR(ours.pixel.x(), seen[0].x, 1e-9);
    EXPECT_NEAR(ours.pixel.y(), seen[0].y, 1e-9);
    EXPECT_TRUE(projector.pixel(p).isApprox(ours.pixel, 1e-12));
    for (int k = 0; k < 3; ++k) {
      constexpr double kStep = 1e-4;
      const Eigen::Vector3d step = kStep * Eigen::Vector3d::Unit(k);
      const Eigen::Vector2d slope =
          (projector.pixel(p + step) - projector.pixel(p - step)) / (2 * kStep);
      EXPECT_LT((ours.d_pixel_d_point.col(k) - slope).norm(), 1e-5) << k;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Coefficients, ProjectorAgainstOpenCv, ::testing::Values(4, 5, 8, 12, 14));

TEST(Pyramid, IsTheSameWithAndWithoutAvx2AtAnySizeAndAsTheReflectionMaskSeesIt) {
  if (best_simd() == Simd::scalar) GTEST_SKIP() << "this CPU has no AVX2";
  cv::RNG random(4);
  for (const int type : {CV_8UC1, CV_8UC3})
    for (const cv::Size size : {cv::Size(4, 4), cv::Size(67, 35), cv::Size(131, 66)}) {
      cv::Mat image(size, type);
      random.fill(image, cv::RNG::UNIFORM, 0, 256);
      Pyramid fast, plain;
      make_pyramid(image, fast, Simd::avx2);
      make_pyramid(image, plain, Simd::scalar);
      GreyAndMask masked;
      make_grey_and_mask(image, ReflectionMaskParameters{}, masked);
      for (std::size_t l = 0; l < kPyramidLevels; ++l) {
        EXPECT_EQ(fast.levels[l].size(), cv::Size(size.width >> l, size.height >> l));
        EXPECT_EQ(cv::norm(fast.levels[l], plain.levels[l], cv::NORM_INF), 0) << size << l;
      }
      EXPECT_EQ(cv::norm(fast.levels[0], masked.grey, cv::NORM_INF), 0);
      EXPECT_EQ(cv::norm(fast.levels[1], masked.half, cv::NORM_INF), 0);
    }
}

struct Kernel : ::testing::Test {
  cv::Mat image{cv::Size(64, 48), CV_8UC1};
  PatchPixels pixels{};
  PatchGeometry geometry;
  Kernel() {
    cv::RNG random(9);
    random.fill(image, cv::RNG::UNIFORM, 0, 256);
    cv::GaussianBlur(image, image, cv::Size(), 1.5);
  }
};

TEST_F(Kernel, SumsAreTheSameWithAndWithoutAvx2) {
  if (best_simd() == Simd::scalar) GTEST_SKIP() << "this CPU has no AVX2";
  ASSERT_TRUE(cut_patch(image, {20, 16}, 1, pixels, geometry));
  for (const PatchPlace& place :
       {PatchPlace{23.5, 19.5}, PatchPlace{22.13, 20.87, 1.1F, 0.2F, -0.15F, 0.9F},
        PatchPlace{8, 8, 0.9F, -0.3F, 0.3F, 0.9F}})
    for (const auto interpolation : {Interpolation::bilinear, Interpolation::bicubic}) {
      ASSERT_TRUE(is_inside(place, image.cols, image.rows));
      const PatchSums a = patch_sums(image, place, pixels, interpolation, Simd::avx2);
      const PatchSums b = patch_sums(image, place, pixels, interpolation, Simd::scalar);
      EXPECT_NEAR(a.i, b.i, 1e-2);
      EXPECT_NEAR(a.ii / b.ii, 1, 1e-5);
      EXPECT_NEAR(a.vi, b.vi, 1e-4F * geometry.squares);
      EXPECT_NEAR(a.gxi, b.gxi, 1e-4F * geometry.squares);
      EXPECT_NEAR(a.gyi, b.gyi, 1e-4F * geometry.squares);
    }
}

TEST_F(Kernel, ATemplateLaidOnItselfIsItselfAndBrightnessAndContrastAreNoMotion) {
  ASSERT_TRUE(cut_patch(image, {20, 16}, 1, pixels, geometry));
  cv::Mat other;
  image.convertTo(other, CV_8U, 0.5, 30);
  for (const cv::Mat& seen : {image, other}) {
    const PatchSums sums =
        patch_sums(seen, PatchPlace{23.5, 19.5}, pixels, Interpolation::bicubic, best_simd());
    const float squares = sums.ii - sums.i * sums.i / kPatchCount;
    EXPECT_NEAR(sums.vi / std::sqrt(squares * geometry.squares), 1, 5e-3);  // halving rounds
    const Eigen::Vector2d moved_px =
        geometry.unit_covariance_px2 *
        Eigen::Vector2d(static_cast<double>(sums.gxi), static_cast<double>(sums.gyi));
    EXPECT_LT(moved_px.norm(), 0.05);
  }
}

TEST_F(Kernel, OutsideIsWhereTheGathersWouldLeaveTheImage) {
  EXPECT_TRUE(is_inside({5.5, 5.5}, 64, 48));
  EXPECT_FALSE(is_inside({5.4, 5.5}, 64, 48));
  EXPECT_TRUE(is_inside({55.5, 39.5}, 64, 48));
  EXPECT_FALSE(is_inside({55.6, 39.5}, 64, 48));
  EXPECT_FALSE(is_inside({std::nan(""), 20}, 64, 48));
  EXPECT_FALSE(is_inside({20, 20, 3, 0, 0, 6}, 64, 48));
}

}  // namespace
}  // namespace holdfast::perception
