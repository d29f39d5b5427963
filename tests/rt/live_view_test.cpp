// SPDX-License-Identifier: Apache-2.0
// The daemon's side of the live view: pictures of a site that moves as is known.
#include "rt/live_view.hpp"

#include <filesystem>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>
#include <unistd.h>

#include "perception/tracker_parameters.hpp"
#include "rt/core/error.hpp"
#include "tests/perception/support/moving_scene.hpp"

namespace holdfast::rt {
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;

constexpr int kWidthPx = 970, kHeightPx = 542, kFactor = 4;
constexpr double kDepthMm = 200;

class LiveViewOfAScene : public ::testing::Test {
 protected:
  void SetUp() override {
    fs::create_directories(folder_);
    const cv::Mat keyframe = scene_.image(Eigen::Isometry3d::Identity(), 2, 99);
    ASSERT_EQ(tracker_.set_keyframe(keyframe, perception::SitePlane{kDepthMm}),
              perception::TrackingReason::none);
  }
  void TearDown() override { fs::remove_all(folder_); }

  /// Tracks and offers; the estimate's time is now, so that the picture is live.
  perception::MotionEstimate offer(cv::Mat& image) {
    const auto estimate = tracker_.track(image, bridge::dds::read_clocks().monotonic);
    live_.offer(image, ++frame_, estimate, tracker_);
    live_.wait();
    return estimate;
  }
  const bridge::LivePicture* look() { return reader_.look(bridge::dds::read_clocks()); }

  const fs::path folder_ =
      fs::temp_directory_path() / ("holdfast-live-view-" + std::to_string(::getpid()));
  const perception::CameraModel camera_ = test::distorted_camera(kWidthPx, kHeightPx);
  const test::MovingScene scene_{camera_, test::photograph(), kDepthMm};
  const perception::TrackerParameters parameters_;
  perception::DirectTracker tracker_{camera_, parameters_};
  LiveView live_{
      {(fs::create_directories(folder_), folder_ / "live"), 300, 15}, camera_, parameters_.mask};
  bridge::LiveReader reader_{folder_ / "live"};
  std::uint64_t frame_ = 0;
};

TEST_F(LiveViewOfAScene, ShowsTheFrameMadeSmall) {
  cv::Mat image = scene_.image(Eigen::Isometry3d(Eigen::Translation3d(1, -0.5, 0)));
  const cv::Mat given = image.clone();
  const auto estimate = offer(image);
  ASSERT_EQ(estimate.status, perception::TrackingStatus::tracking);
  const bridge::LivePicture* picture = look();
  ASSERT_NE(picture, nullptr) << sentence(reader_.why());
  EXPECT_EQ(picture->frame, 1U);
  EXPECT_EQ(picture->t_exposure, estimate.t_exposure);
  ASSERT_EQ(picture->factor, kFactor);
  ASSERT_EQ(picture->width_px, 240);
  ASSERT_EQ(picture->height_px, 132);
  for (int y = 0; y < picture->height_px; y += 11)
    for (int x = 0; x < picture->width_px; x += 7)
      EXPECT_NEAR(picture->pixels[static_cast<std::size_t>(y * picture->width_px + x)],
                  cv::mean(given(cv::Rect(kFactor * x, kFactor * y, kFactor, kFactor)))[0], 1);
}

TEST_F(LiveViewOfAScene, ShowsColourAsRedGreenBlue) {
  cv::Mat image(kHeightPx, kWidthPx, CV_8UC3, cv::Scalar(10, 90, 170));  // blue, green, red
  (void)offer(image);
  const bridge::LivePicture* picture = look();
  ASSERT_NE(picture, nullptr) << sentence(reader_.why());
  ASSERT_EQ(picture->channels, 3);
  EXPECT_EQ(picture->pixels.size(), 240U * 132U * 3U);
  const std::vector<std::uint8_t> first(picture->pixels.begin(), picture->pixels.begin() + 3);
  EXPECT_EQ(first, (std::vector<std::uint8_t>{170, 90, 10}));
}

TEST_F(LiveViewOfAScene, ShowsInliersAndTheMotionWhereTheyAre) {
  cv::Mat still = scene_.image(Eigen::Isometry3d::Identity());
  (void)offer(still);
  ASSERT_NE(look(), nullptr);
  const auto points_before = look()->points;
  cv::Mat image = scene_.image(Eigen::Isometry3d(Eigen::Translation3d(1.6, -0.8, 0)));
  (void)tracker_.track(image, bridge::dds::read_clocks().monotonic);
  LiveView again({folder_ / "again", 300, 15}, camera_, parameters_.mask);
  const auto estimate = tracker_.track(image, bridge::dds::read_clocks().monotonic);
  again.offer(image, 3, estimate, tracker_);
  again.wait();
  bridge::LiveReader reader(folder_ / "again");
  const bridge::LivePicture* picture = reader.look(bridge::dds::read_clocks());
  ASSERT_NE(picture, nullptr);
  // 0.02 mm a pixel: 80 and -40 of the camera's pixels.
  ASSERT_TRUE(picture->has_motion);
  EXPECT_NEAR(picture->to.x_px - picture->from.x_px, 80.0 / kFactor, 0.3);
  EXPECT_NEAR(picture->to.y_px - picture->from.y_px, -40.0 / kFactor, 0.3);
  EXPECT_NEAR(picture->from.x_px, picture->of_camera_px(camera_.cx_px), 0.5);
  EXPECT_NEAR(picture->plane_depth_mm, kDepthMm, 1e-6);
  EXPECT_EQ(picture->inliers, estimate.inliers);
  EXPECT_GT(picture->points.size(), 100U);
  EXPECT_LE(picture->points.size(), static_cast<std::size_t>(estimate.inliers));
  // Most points of the moved site lie where one of the still site lay, moved.
  std::size_t moved = 0;
  for (const auto& p : picture->points)
    moved += std::any_of(points_before.begin(), points_before.end(),
                         [&](const bridge::LivePoint& q) {
                           return std::hypot(p.x_px - q.x_px - 20, p.y_px - q.y_px + 10) < 1;
                         })
                 ? 1U
                 : 0U;
  EXPECT_GT(moved, picture->points.size() * 8 / 10);
}

TEST_F(LiveViewOfAScene, LostFrameIsShownWithoutMotionOrInliers) {
  cv::Mat image(kHeightPx, kWidthPx, CV_8UC1, cv::Scalar(90));
  const auto estimate = offer(image);
  ASSERT_EQ(estimate.status, perception::TrackingStatus::lost);
  const bridge::LivePicture* picture = look();
  ASSERT_NE(picture, nullptr);
  EXPECT_EQ(picture->status, perception::TrackingStatus::lost);
  EXPECT_EQ(picture->reason, estimate.reason);
  EXPECT_FALSE(picture->has_motion);
  EXPECT_TRUE(picture->points.empty());
  EXPECT_EQ(picture->pixels[0], 90);
}

TEST_F(LiveViewOfAScene, ShowsWhatTheReflectionMaskTakes) {
  cv::Mat image = scene_.image(Eigen::Isometry3d::Identity());
  image *= 0.5;
  cv::circle(image, {400, 200}, 40, cv::Scalar(255), cv::FILLED);
  (void)offer(image);
  const bridge::LivePicture* picture = look();
  ASSERT_NE(picture, nullptr);
  const auto masked = [picture](int camera_x, int camera_y) {
    const int cell = kFactor * bridge::kLiveMaskCellPx;
    return picture->mask[static_cast<std::size_t>(
        camera_y / cell * (picture->width_px / bridge::kLiveMaskCellPx) + camera_x / cell)];
  };
  EXPECT_EQ(masked(400, 200), 255);
  EXPECT_EQ(masked(800, 400), 0);
  EXPECT_EQ(masked(400, 300), 0);
}

TEST_F(LiveViewOfAScene, TakesTheImageForAnotherOneAtMostSoOften) {
  using std::chrono::nanoseconds;
  const cv::Mat scene = scene_.image(Eigen::Isometry3d::Identity());
  perception::MotionEstimate estimate;
  int taken = 0;
  for (int i = 0; i < 60; ++i) {  // two seconds at 30 frames a second, stamps a little uneven
    cv::Mat image = scene.clone();
    const void* data = image.data;
    estimate.t_exposure =
        nanoseconds(1'000'000'000LL * i / 30 + (i % 3 - 1) * 200'000LL) + std::chrono::hours(1);
    live_.offer(image, static_cast<std::uint64_t>(i), estimate, tracker_);
    live_.wait();
    taken += image.data == data ? 0 : 1;
  }
  EXPECT_GE(taken, 29);
  EXPECT_LE(taken, 31);
}

TEST_F(LiveViewOfAScene, RefusesAFrameThatMakesNoPicture) {
  EXPECT_THROW(
      LiveView({folder_ / "thin", 64, 15}, test::microscope_camera(4000, 200), parameters_.mask),
      InputError);
}

}  // namespace
}  // namespace holdfast::rt
