// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/disturbance.hpp"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "rt/core/error.hpp"

namespace holdfast::sim {
namespace {

constexpr int kWidthPx = 640, kHeightPx = 360;

cv::Mat_<float> texture(int seed) {
  cv::Mat_<float> noise(kHeightPx, kWidthPx);
  cv::RNG(static_cast<std::uint64_t>(seed)).fill(noise, cv::RNG::NORMAL, 120, 120);
  cv::GaussianBlur(noise, noise, {}, 2);
  return noise;
}

double contrast(const cv::Mat& light) {
  cv::Scalar mean, deviation;
  cv::meanStdDev(light, mean, deviation);
  return deviation[0];
}

class DisturbancesTest : public ::testing::Test {
 protected:
  DisturbancesTest() {
    shot.optics = Microscope().at(1.3);
    shot.region = {(kSensorWidthPx - kWidthPx) / 2, (kSensorHeightPx - kHeightPx) / 2, kWidthPx,
                   kHeightPx};
  }
  /// The picture at `t_s`, the camera `moved_mm` to the left: the site goes right.
  cv::Mat_<float> seen(const char* program, double t_s, cv::Mat_<float> light,
                       double moved_mm = 0) const {
    const Eigen::Isometry3d T_ct_camera(Eigen::Translation3d(-moved_mm, 0, 0));
    Disturbances(program).draw(light, {shot, depth_mm, T_ct_camera, Eigen::Isometry3d::Identity()},
                               t_s);
    return light;
  }
  RoomShot shot;
  cv::Mat_<float> depth_mm = cv::Mat_<float>(kHeightPx, kWidthPx, 200.F);
};

TEST_F(DisturbancesTest, RefusesWhatItDoesNotKnow) {
  for (const char* wrong :
       {"fog:1:2", "smoke", "smoke:1", "smoke:1:2:3:4", "smoke:x:2", "smoke:-1:2", "smoke:0:0",
        "smoke:0:nan", "smoke:0:1:0", "smoke:0:1:9", "zoom:0:1", "zoom:0:1:2", "smoke:0:1,"})
    EXPECT_THROW(Disturbances{wrong}, InputError) << wrong;
  EXPECT_TRUE(Disturbances("").is_empty());
  EXPECT_FALSE(Disturbances("smoke:0:1").is_empty());
}

TEST_F(DisturbancesTest, NothingIsSeenOfTheSiteBehindAnOcclusion) {
  const char* program = "occlusion:1:2";
  const cv::Mat_<float> one = texture(1), other = texture(2);
  EXPECT_EQ(cv::norm(seen(program, 0.99, one.clone()), one), 0);
  EXPECT_EQ(cv::norm(seen(program, 3.01, one.clone()), one), 0);
  for (const double t_s : {1.21, 2.0, 2.79})
    EXPECT_LT(
        cv::norm(seen(program, t_s, one.clone()), seen(program, t_s, other.clone()), cv::NORM_INF),
        1e-3)
        << t_s;
  EXPECT_GT(
      cv::norm(seen(program, 1.1, one.clone()), seen(program, 1.1, other.clone()), cv::NORM_INF),
      10)
      << "half way in";
}

TEST_F(DisturbancesTest, SmokeTakesContrastDriftsAndGoes) {
  const char* program = "smoke:0:4";
  const cv::Mat_<float> clear = texture(1);
  const cv::Mat_<float> thick = seen(program, 2, clear.clone());
  EXPECT_LT(contrast(thick), 0.5 * contrast(clear));
  EXPECT_GT(cv::norm(thick, seen(program, 2.2, clear.clone()), cv::NORM_INF), 3);
  EXPECT_EQ(cv::norm(seen(program, 4, clear.clone()), clear), 0);
}

TEST_F(DisturbancesTest, BloodGrowsStaysAndMovesWithTheSite) {
  const char* program = "blood:0:2";
  const cv::Mat_<float> clear(kHeightPx, kWidthPx, 100.F);
  const auto covered = [&](const cv::Mat_<float>& light) { return cv::countNonZero(light < 99); };
  const cv::Mat_<float> late = seen(program, 2, clear.clone());
  EXPECT_GT(covered(late), 2 * covered(seen(program, 0.5, clear.clone())));
  EXPECT_EQ(cv::norm(seen(program, 5, clear.clone()), late), 0);
  const double moved_mm = 1;
  const int moved_px = static_cast<int>(std::lround(moved_mm / 200 * shot.optics.left.focal_px()));
  const cv::Mat_<float> moved = seen(program, 2, clear.clone(), moved_mm);
  const cv::Rect before(20, 20, kWidthPx - 40 - moved_px, kHeightPx - 40);
  const double still = cv::norm(late(before), moved(before), cv::NORM_L1),
               followed =
                   cv::norm(late(before), moved(before + cv::Point(moved_px, 0)), cv::NORM_L1);
  EXPECT_LT(followed, 0.1 * still);
}

TEST_F(DisturbancesTest, FlickerIsTheLampsAndDefocusTheLensS) {
  const Disturbances both("flicker:0:2,defocus:0:2");
  double least = 1, most = 1;
  for (double t_s = 0.01; t_s < 2; t_s += 0.01) {
    RoomShot now = shot;
    both.set(now, t_s);
    least = std::min(least, now.sensor.exposure);
    most = std::max(most, now.sensor.exposure);
  }
  EXPECT_NEAR(least, 0.75, 0.05);
  EXPECT_NEAR(most, 1.25, 0.05);
  RoomShot middle = shot, after = shot;
  both.set(middle, 1);
  both.set(after, 2.1);
  EXPECT_NEAR(middle.optics.blur_px, 4, 0.2);
  EXPECT_EQ(after.optics.blur_px, shot.optics.blur_px);
  EXPECT_EQ(after.sensor.exposure, shot.sensor.exposure);
}

TEST_F(DisturbancesTest, ZoomIsAnotherInItsTime) {
  const Disturbances step("zoom:1:0.5:1.4");
  EXPECT_FALSE(step.zoom(0.99));
  EXPECT_EQ(step.zoom(1.0), 1.4);
  EXPECT_FALSE(step.zoom(1.5));
}

}  // namespace
}  // namespace holdfast::sim
