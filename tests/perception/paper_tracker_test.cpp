// SPDX-License-Identifier: Apache-2.0
// Paper B's own method: what it can do, and what it cannot.
#include "perception/paper_tracker.hpp"

#include <chrono>
#include <cmath>

#include <gtest/gtest.h>

#include "perception/tracker_parameters.hpp"
#include "tests/perception/support/moving_scene.hpp"

namespace holdfast::perception {
namespace {

class PaperTrackerOnAScene : public ::testing::Test {
 protected:
  const CameraModel camera = test::microscope_camera(960, 540);
  const test::MovingScene scene{camera, test::photograph(), 200};
  PaperTracker tracker{camera, TrackerParameters{}};
  int frame = 0;

  void SetUp() override {
    ASSERT_EQ(
        tracker.set_keyframe(scene.image(Eigen::Isometry3d::Identity(), 2, 99), SitePlane{200}),
        TrackingReason::none);
  }
  MotionEstimate see(const cv::Mat& image) {
    return tracker.track(image, std::chrono::milliseconds(33 * ++frame));
  }
  [[nodiscard]] cv::Mat moved(double x_mm, double y_mm, double turn_rad = 0) const {
    return scene.image(test::moved_about({0, 0, 200}, {x_mm, y_mm, 0}, {0, 0, turn_rad}), 2,
                       static_cast<std::uint64_t>(frame));
  }
};

TEST_F(PaperTrackerOnAScene, CascadesTheMotionFromFrameToFrame) {
  MotionEstimate e;
  for (int i = 1; i <= 6; ++i) {
    e = see(moved(0.1 * i, -0.05 * i, 0.003 * i));
    ASSERT_EQ(e.status, TrackingStatus::tracking) << name(e.reason);
    EXPECT_FALSE(e.covariance.allFinite()) << "the method knows no uncertainty";
  }
  EXPECT_NEAR(e.dx_um, 600, 30);
  EXPECT_NEAR(e.dy_um, -300, 30);
  EXPECT_NEAR(e.rotation_rad, 0.018, 0.002);
  EXPECT_NEAR(e.scale, 1, 0.005);
}

TEST_F(PaperTrackerOnAScene, MissesTheMotionBehindAnOcclusionAndDoesNotKnow) {
  ASSERT_EQ(see(moved(0.1, 0)).status, TrackingStatus::tracking);
  ASSERT_EQ(see(cv::Mat(540, 960, CV_8UC1, cv::Scalar(90))).status, TrackingStatus::lost);
  (void)see(moved(1.1, 0));
  const auto e = see(moved(1.2, 0));
  EXPECT_EQ(e.status, TrackingStatus::tracking);
  EXPECT_GT(std::abs(e.dx_um - 1200), 100) << "as good as a keyframe: then why have one";
}

TEST_F(PaperTrackerOnAScene, StampsThatDoNotIncreaseGiveNoPose) {
  const cv::Mat image = moved(0.1, 0);
  EXPECT_EQ(tracker.track(image, std::chrono::milliseconds(5)).status, TrackingStatus::tracking);
  EXPECT_EQ(tracker.track(image, std::chrono::milliseconds(5)).reason,
            TrackingReason::time_not_increasing);
}

}  // namespace
}  // namespace holdfast::perception
