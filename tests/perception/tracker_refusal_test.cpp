// SPDX-License-Identifier: Apache-2.0
// What the tracker must not be fooled by: never a crash, never a wrong pose given as a good one.
#include <limits>
#include <stdexcept>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "perception/direct_tracker.hpp"
#include "perception/tracker.hpp"
#include "perception/tracker_parameters.hpp"
#include "tests/perception/support/moving_scene.hpp"

namespace holdfast::perception {
namespace {

const Eigen::Isometry3d kStill = Eigen::Isometry3d::Identity();

Eigen::Isometry3d shifted(double x_mm, double y_mm) {
  return Eigen::Isometry3d(Eigen::Translation3d(x_mm, y_mm, 0));
}

template <typename AnyTracker>
class TrackerRefusal : public ::testing::Test {
 protected:
  const CameraModel camera = test::microscope_camera(1280, 720);
  const test::MovingScene scene{camera, test::photograph(), 200};
  AnyTracker tracker{camera, TrackerParameters{}};
  std::chrono::nanoseconds t{};

  MotionEstimate track(const cv::Mat& image) {
    t += std::chrono::milliseconds(33);
    return tracker.track(image, t);
  }

  void take_keyframe() {
    ASSERT_EQ(tracker.set_keyframe(scene.image(kStill, 2, 77), SitePlane{200}),
              TrackingReason::none);
  }
  void expect_lost(const cv::Mat& image, TrackingReason reason) {
    const MotionEstimate e = track(image);
    EXPECT_EQ(e.status, TrackingStatus::lost);
    EXPECT_EQ(e.reason, reason) << name(e.reason);
    EXPECT_TRUE(e.T_camera_site.isApprox(kStill)) << "a lost frame must carry no pose";
    EXPECT_EQ(e.inliers, 0);
    EXPECT_FALSE(e.has_drift);
  }
};

using Trackers = ::testing::Types<Tracker, DirectTracker>;
TYPED_TEST_SUITE(TrackerRefusal, Trackers);

TYPED_TEST(TrackerRefusal, NoKeyframe) {
  this->expect_lost(this->scene.image(kStill), TrackingReason::no_keyframe);
}

TYPED_TEST(TrackerRefusal, WrongSizeTypeOrEmpty) {
  this->take_keyframe();
  this->expect_lost(cv::Mat(), TrackingReason::wrong_image_size);
  this->expect_lost(cv::Mat(1, 1, CV_8UC1, cv::Scalar(0)), TrackingReason::wrong_image_size);
  this->expect_lost(cv::Mat(720, 1279, CV_8UC1, cv::Scalar(0)), TrackingReason::wrong_image_size);
  this->expect_lost(cv::Mat(720, 1280, CV_16UC1, cv::Scalar(0)), TrackingReason::wrong_image_type);
  this->expect_lost(cv::Mat(720, 1280, CV_8UC4, cv::Scalar(0)), TrackingReason::wrong_image_type);
}

TYPED_TEST(TrackerRefusal, NothingToSee) {
  this->RecordProperty("requirement", "SR-63");
  this->take_keyframe();
  for (const int grey : {0, 128, 255})
    this->expect_lost(cv::Mat(720, 1280, CV_8UC1, cv::Scalar(grey)),
                      TrackingReason::too_few_features);
}

TYPED_TEST(TrackerRefusal, NoiseAlone) {
  this->RecordProperty("requirement", "SR-63");
  this->take_keyframe();
  cv::Mat noise(720, 1280, CV_8UC1);
  cv::RNG random(5);
  random.fill(noise, cv::RNG::UNIFORM, 0, 256);
  EXPECT_EQ(this->track(noise).status, TrackingStatus::lost);
}

TYPED_TEST(TrackerRefusal, AnotherScene) {
  this->RecordProperty("requirement", "SR-63");
  this->take_keyframe();
  const test::MovingScene other(this->camera, test::other_photograph(), 200);
  for (int i = 0; i < 3; ++i)
    EXPECT_EQ(this->track(other.image(shifted(0.1 * i, 0))).status, TrackingStatus::lost);
}

TYPED_TEST(TrackerRefusal, AKeyframeThatCannotServeLeavesTheFormerOne) {
  this->take_keyframe();
  const cv::Mat black(720, 1280, CV_8UC1, cv::Scalar(0));
  EXPECT_EQ(this->tracker.set_keyframe(black, SitePlane{200}), TrackingReason::too_few_features);
  const cv::Mat image = this->scene.image(kStill);
  EXPECT_EQ(this->tracker.set_keyframe(image.rowRange(0, 100), SitePlane{200}),
            TrackingReason::wrong_image_size);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (const double depth_mm : {-1.0, 0.0, nan, 1e9})
    EXPECT_EQ(this->tracker.set_keyframe(image, SitePlane{depth_mm}),
              TrackingReason::invalid_geometry);
  EXPECT_EQ(
      this->tracker.set_keyframe(image, SiteDepth{cv::Mat(720, 1280, CV_32FC1, cv::Scalar(nan))}),
      TrackingReason::invalid_geometry);
  EXPECT_EQ(
      this->tracker.set_keyframe(image, SiteDepth{cv::Mat(72, 128, CV_32FC1, cv::Scalar(200))}),
      TrackingReason::invalid_geometry);
  EXPECT_EQ(this->track(this->scene.image(shifted(0.1, 0))).status, TrackingStatus::tracking);
}

TYPED_TEST(TrackerRefusal, AScenePeriodicEverywhereGivesNoPose) {
  cv::Mat tile, periodic(720, 1280, CV_8UC1);
  cv::RNG random(3);
  tile.create(40, 40, CV_8UC1);
  random.fill(tile, cv::RNG::UNIFORM, 0, 256);
  cv::GaussianBlur(tile, tile, cv::Size(), 1.5);
  cv::repeat(tile, 18, 32, periodic);
  // Refused as a keyframe, since it is not found again in itself, or no pose from it.
  if (this->tracker.set_keyframe(periodic, SitePlane{200}) != TrackingReason::none) return;
  cv::Mat moved;
  cv::copyMakeBorder(periodic.colRange(0, 1260), moved, 0, 0, 20, 0, cv::BORDER_WRAP);
  const MotionEstimate e = this->track(moved);
  EXPECT_EQ(e.status, TrackingStatus::lost) << e.dx_um << " um, " << e.inliers << " inliers";
}

TYPED_TEST(TrackerRefusal, LostThenRelocalisedThenTracking) {
  this->take_keyframe();
  EXPECT_EQ(this->track(this->scene.image(shifted(0.1, 0), 2, 1)).status, TrackingStatus::tracking);
  const cv::Mat covered(720, 1280, CV_8UC1, cv::Scalar(90));
  EXPECT_EQ(this->track(covered).status, TrackingStatus::lost);
  // The site has moved far while it could not be seen.
  const auto found = this->track(this->scene.image(shifted(2.5, 1.5), 2, 2));
  EXPECT_EQ(found.status, TrackingStatus::relocalised);
  EXPECT_NEAR(found.dx_um, 2500, 2);
  EXPECT_FALSE(found.has_drift) << "the chain broke";
  const auto next = this->track(this->scene.image(shifted(2.6, 1.5), 2, 3));
  EXPECT_EQ(next.status, TrackingStatus::tracking);
  EXPECT_TRUE(next.has_drift);
}

TYPED_TEST(TrackerRefusal, PartialOcclusionIsRightOrSaysSo) {
  this->take_keyframe();
  for (const int covered_px : {300, 600, 900, 1150, 1240}) {
    cv::Mat image = this->scene.image(shifted(0.5, 0.2), 2, 4);
    image.colRange(0, covered_px).setTo(60);
    const auto e = this->track(image);
    if (e.status == TrackingStatus::lost) continue;
    EXPECT_NEAR(e.dx_um, 500, 5) << covered_px;
    EXPECT_NEAR(e.dy_um, 200, 5) << covered_px;
    if (covered_px > 1200) {
      EXPECT_EQ(e.status, TrackingStatus::degraded) << covered_px;
    }
  }
}

TYPED_TEST(TrackerRefusal, AFrozenFrameKeepsItsPoseAndItsZeroMotion) {
  this->take_keyframe();
  const cv::Mat image = this->scene.image(shifted(0.3, 0), 2, 4);
  const auto first = this->track(image);
  const auto second = this->track(image);
  EXPECT_NEAR(first.dx_um, second.dx_um, 0.05);
  EXPECT_NEAR(second.frame_to_frame_dx_um, 0, 0.01);
}

TYPED_TEST(TrackerRefusal, HalfTheImageMovingOnItsOwnIsNotTracking) {
  this->take_keyframe();
  cv::Mat image = this->scene.image(shifted(0.8, 0), 2, 4);
  this->scene.image(shifted(-0.6, 0.4), 2, 5).colRange(0, 600).copyTo(image.colRange(0, 600));
  EXPECT_EQ(this->track(image).reason, TrackingReason::inconsistent_motion);
}

TYPED_TEST(TrackerRefusal, DuplicatedAndSwappedStampsGiveNoPoseAndTrackingGoesOn) {
  this->take_keyframe();
  const cv::Mat image = this->scene.image(shifted(0.2, 0), 2, 1);
  const auto at = [&](int ms) { return this->tracker.track(image, std::chrono::milliseconds(ms)); };
  EXPECT_EQ(at(100).status, TrackingStatus::tracking);
  for (const int ms : {100, 70}) {
    const auto e = at(ms);
    EXPECT_EQ(e.status, TrackingStatus::lost);
    EXPECT_EQ(e.reason, TrackingReason::time_not_increasing);
  }
  EXPECT_EQ(at(133).status, TrackingStatus::tracking);
}

TEST(Tracker, RefusesAnImpossibleCameraOrParameter) {
  CameraModel camera = test::microscope_camera(1280, 720);
  TrackerParameters parameters;
  parameters.match.ratio_max = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(Tracker(camera, parameters), std::invalid_argument);
  camera.fx_px = 0;
  EXPECT_THROW(Tracker(camera, TrackerParameters{}), std::invalid_argument);
  camera = test::microscope_camera(1280, 720);
  camera.distortion = (cv::Mat_<double>(1, 5) << -4000, 0, 0, 0, 0);  // folds the image over
  EXPECT_THROW(Tracker(camera, TrackerParameters{}), std::invalid_argument);
}

// Glints stay with the light while the site moves below them.
class TrackerGlints : public ::testing::TestWithParam<bool> {};

cv::Mat with_glints(cv::Mat image) {
  cv::RNG random(11);
  for (int i = 0; i < 260; ++i) {
    const cv::Point centre(random.uniform(20, 1260), random.uniform(20, 700));
    cv::ellipse(image, centre, cv::Size(random.uniform(3, 9), random.uniform(2, 6)),
                random.uniform(0, 180), 0, 360, cv::Scalar::all(255), cv::FILLED, cv::LINE_AA);
  }
  return image;
}

MotionEstimate track_below_glints(bool is_colour, bool is_masked) {
  const CameraModel camera = test::microscope_camera(1280, 720);
  const test::MovingScene scene(camera, 0.6 * test::photograph(is_colour), 200);
  TrackerParameters parameters;
  parameters.mask.is_enabled = is_masked;
  Tracker tracker(camera, parameters);
  EXPECT_EQ(tracker.set_keyframe(with_glints(scene.image(kStill, 2, 1)), SitePlane{200}),
            TrackingReason::none);
  return tracker.track(with_glints(scene.image(shifted(1.2, 0.5), 2, 2)), {});
}

TEST_P(TrackerGlints, WithoutTheMaskTheyVoteForStandingStill) {
  const auto e = track_below_glints(GetParam(), false);
  EXPECT_TRUE(e.status != TrackingStatus::tracking || std::abs(e.dx_um - 1200) > 100)
      << "no danger left to guard against: the next test proves nothing";
}

TEST_P(TrackerGlints, WithTheMaskTheSiteIsTracked) {
  RecordProperty("requirement", "SR-64");
  const auto e = track_below_glints(GetParam(), true);
  EXPECT_EQ(e.status, TrackingStatus::tracking) << name(e.reason);
  EXPECT_NEAR(e.dx_um, 1200, 3);
  EXPECT_NEAR(e.dy_um, 500, 3);
}

TEST_P(TrackerGlints, DirectAlignmentIsNotHeldBackByThem) {
  RecordProperty("requirement", "SR-64");
  const CameraModel camera = test::microscope_camera(1280, 720);
  const test::MovingScene scene(camera, 0.6 * test::photograph(GetParam()), 200);
  DirectTracker tracker(camera, TrackerParameters{});
  ASSERT_EQ(tracker.set_keyframe(with_glints(scene.image(kStill, 2, 1)), SitePlane{200}),
            TrackingReason::none);
  const auto e = tracker.track(with_glints(scene.image(shifted(1.2, 0.5), 2, 2)), {});
  EXPECT_TRUE(e.status == TrackingStatus::tracking || e.status == TrackingStatus::relocalised)
      << name(e.reason);
  EXPECT_NEAR(e.dx_um, 1200, 1);
  EXPECT_NEAR(e.dy_um, 500, 1);
}

INSTANTIATE_TEST_SUITE_P(GreyAndColour, TrackerGlints, ::testing::Bool());

}  // namespace
}  // namespace holdfast::perception
