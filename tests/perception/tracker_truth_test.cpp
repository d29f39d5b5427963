// SPDX-License-Identifier: Apache-2.0
// The tracker against known motions of a real photograph: error, and whether the covariance that
// comes with it is honest.
#include <cmath>
#include <random>

#include <gtest/gtest.h>

#include "perception/tracker.hpp"
#include "perception/tracker_parameters.hpp"
#include "tests/perception/support/moving_scene.hpp"

namespace holdfast::perception {
namespace {

using test::error_of;
using Vector6d = Eigen::Matrix<double, 6, 1>;

struct Truth {
  Eigen::Vector3d t_mm, r_rad;
};

/// A walk of the site: some tenths of a millimetre and milliradians a frame.
std::vector<Truth> walk(int frames, bool is_rigid) {
  std::mt19937 random(7);
  std::normal_distribution<double> normal;
  std::vector<Truth> truths;
  Truth now{Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()};
  for (int i = 0; i < frames; ++i) {
    now.t_mm += Eigen::Vector3d(0.3 * normal(random), 0.3 * normal(random), 0.1 * normal(random));
    now.r_rad.z() += 0.004 * normal(random);
    if (is_rigid) now.r_rad.head<2>() += 0.002 * Eigen::Vector2d(normal(random), normal(random));
    truths.push_back(now);
  }
  return truths;
}

struct Case {
  const char* label;
  bool is_distorted, is_rigid;
  double bound_um;  ///< in the image plane; the scene has 20 um per pixel
};

class TrackerTruth : public ::testing::TestWithParam<Case> {};

TEST_P(TrackerTruth, ErrorIsMicrometresAndWithinItsCovariance) {
  const Case& c = GetParam();
  const CameraModel camera =
      c.is_distorted ? test::distorted_camera(1280, 720) : test::microscope_camera(1280, 720);
  const test::MovingScene scene(camera, test::photograph(), 200, c.is_rigid ? 4 : 0);
  Tracker tracker(camera, TrackerParameters{});
  SiteGeometry geometry = SitePlane{200};
  if (c.is_rigid) geometry = SiteDepth{scene.depth_mm()};
  ASSERT_EQ(tracker.set_keyframe(scene.image(Eigen::Isometry3d::Identity(), 2, 1000), geometry),
            TrackingReason::none);

  double chi2 = 0;
  int frames = 0;
  for (const Truth& truth : walk(12, c.is_rigid)) {
    const auto T = test::moved_about(scene.p_pivot_mm(), truth.t_mm, truth.r_rad);
    const auto e = tracker.track(scene.image(T, 2, static_cast<std::uint64_t>(frames)),
                                 std::chrono::nanoseconds(frames));
    ASSERT_EQ(e.status, TrackingStatus::tracking) << frames << ' ' << name(e.reason);
    const Vector6d error = error_of(e, T);
    EXPECT_LT(1000 * error.head<2>().norm(), c.bound_um) << frames;
    EXPECT_LT(1000 * std::abs(error.z()), 30) << frames;  // of 200 mm
    const Vector6d sigma = e.covariance.diagonal().cwiseSqrt();
    for (int k = 0; k < 6; ++k) EXPECT_LT(std::abs(error[k]), 4 * sigma[k]) << frames << ' ' << k;
    EXPECT_LT(sigma.head<2>().maxCoeff(), 0.1) << "so wide that it says nothing";
    chi2 += error.dot(e.covariance.ldlt().solve(error));
    ++frames;
  }
  // Conservative: the mean of the normalised error squared must not exceed its expectation.
  EXPECT_LT(chi2 / frames, 6.0);
}

INSTANTIATE_TEST_SUITE_P(
    Scenes, TrackerTruth,
    ::testing::Values(Case{"Plane", false, false, 1.0}, Case{"PlaneDistorted", true, false, 1.0},
                      Case{"Relief", false, true, 1.5}, Case{"ReliefDistorted", true, true, 1.5}),
    [](const auto& param_info) { return std::string(param_info.param.label); });

TEST(Tracker, CovarianceWithoutMotionIsNotDrownedInTheShapeTerm) {
  // At the keyframe's own place the shape of the site cannot matter: only noise is left, and the
  // measured scatter must agree with the sigma given, neither far above nor below it.
  const CameraModel camera = test::microscope_camera(1280, 720);
  const test::MovingScene scene(camera, test::photograph(), 200);
  Tracker tracker(camera, TrackerParameters{});
  const auto still = Eigen::Isometry3d::Identity();
  ASSERT_EQ(tracker.set_keyframe(scene.image(still, 2, 1000), SitePlane{200}),
            TrackingReason::none);
  double squares = 0, variance = 0;
  for (std::uint64_t i = 0; i < 10; ++i) {
    const auto e = tracker.track(scene.image(still, 2, i), std::chrono::nanoseconds(i));
    ASSERT_EQ(e.status, TrackingStatus::tracking);
    squares += error_of(e, still).head<2>().squaredNorm();
    variance += e.covariance.topLeftCorner<2, 2>().trace();
  }
  EXPECT_LT(squares, 1.5 * variance);
  EXPECT_GT(squares, 0.02 * variance);
}

TEST(Tracker, ReportsImagePlaneMotionRightAndDownPositive) {
  const CameraModel camera = test::microscope_camera(1280, 720);
  const test::MovingScene scene(camera, test::photograph(), 200);
  Tracker tracker(camera, TrackerParameters{});
  ASSERT_EQ(tracker.set_keyframe(scene.image(Eigen::Isometry3d::Identity()), SitePlane{200}),
            TrackingReason::none);
  const auto T = test::moved_about({0, 0, 200}, {0.4, -0.2, 0}, Eigen::Vector3d::Zero());
  const auto e = tracker.track(scene.image(T, 2, 5), std::chrono::nanoseconds(42));
  EXPECT_NEAR(e.dx_um, 400, 1);
  EXPECT_NEAR(e.dy_um, -200, 1);
  EXPECT_NEAR(e.rotation_rad, 0, 1e-4);
  EXPECT_NEAR(e.scale, 1, 1e-4);
  EXPECT_EQ(e.t_exposure, std::chrono::nanoseconds(42));
  EXPECT_GT(e.inlier_spread, 0.5);
}

TEST(Tracker, FrameToFrameMotionAgreesWithTheKeyframeAndSoDoesTheDrift) {
  RecordProperty("requirement", "SR-65");
  const CameraModel camera = test::microscope_camera(1280, 720);
  const test::MovingScene scene(camera, test::photograph(), 200);
  Tracker tracker(camera, TrackerParameters{});
  ASSERT_EQ(tracker.set_keyframe(scene.image(Eigen::Isometry3d::Identity()), SitePlane{200}),
            TrackingReason::none);
  for (int i = 0; i < 8; ++i) {
    const auto T = test::moved_about({0, 0, 200}, {0.1 * i, 0.05 * i, 0}, {0, 0, 0.001 * i});
    const auto e = tracker.track(scene.image(T, 2, static_cast<std::uint64_t>(i + 9)),
                                 std::chrono::nanoseconds(i));
    ASSERT_EQ(e.status, TrackingStatus::tracking);
    if (i == 0) {
      EXPECT_FALSE(e.has_frame_to_frame);
      EXPECT_FALSE(e.has_drift);
      continue;
    }
    ASSERT_TRUE(e.has_frame_to_frame && e.has_drift);
    EXPECT_NEAR(e.frame_to_frame_dx_um, 100, 1.5);
    EXPECT_NEAR(e.frame_to_frame_dy_um, 50, 1.5);
    EXPECT_LT(e.drift_um, 5);
  }
}

}  // namespace
}  // namespace holdfast::perception
