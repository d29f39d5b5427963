// SPDX-License-Identifier: Apache-2.0
// Real recordings that Debian packages carry: the 501-frame sequence of visp-images-data, and the
// graf pair with its true homography of opencv-doc.
#include <cstdio>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgcodecs.hpp>

#include "perception/features.hpp"
#include "perception/matcher.hpp"
#include "perception/reflection_mask.hpp"
#include "perception/tracker.hpp"
#include "tests/perception/support/moving_scene.hpp"

namespace holdfast::perception {
namespace {

constexpr int kFrames = 501;

cv::Mat sequence_frame(int index) {
  char file[32];
  std::snprintf(file, sizeof file, "image.%04d.pgm", index + 1);
  return cv::imread(test::visp_images + "mire-2/" + file, cv::IMREAD_GRAYSCALE);
}

CameraModel sequence_camera() {
  CameraModel camera;
  camera.width_px = 384;
  camera.height_px = 288;
  camera.fx_px = camera.fy_px = 600;
  camera.cx_px = 192;
  camera.cy_px = 144;
  return camera;
}

constexpr double kDepthMm = 300, kPixelUm = 1000 * kDepthMm / 600;

TEST(RealSequence, IsFollowedFromTheFirstFrameToTheLastWithoutAJump) {
  Tracker tracker(sequence_camera(), TrackerParameters{});
  ASSERT_FALSE(sequence_frame(0).empty()) << "install visp-images-data";
  ASSERT_EQ(tracker.set_keyframe(sequence_frame(0), SitePlane{kDepthMm}), TrackingReason::none);
  int poses = 0;
  double furthest_jump_um = 0;
  for (int i = 0; i < kFrames; ++i) {
    const auto e = tracker.track(sequence_frame(i), std::chrono::nanoseconds(i));
    if (e.status == TrackingStatus::lost) continue;
    ++poses;
    // What two independent measurements say of the same motion.
    if (e.has_drift) furthest_jump_um = std::max(furthest_jump_um, e.drift_um);
  }
  EXPECT_GE(poses, 495);
  EXPECT_LT(furthest_jump_um, kPixelUm);  // a pixel, over chains of 300 frames
}

TEST(RealSequence, ForwardsAndBackwardsAgree) {
  const CameraModel camera = sequence_camera();
  for (const int other : {40, 200, 400, 500}) {
    Tracker forwards(camera, TrackerParameters{}), backwards(camera, TrackerParameters{});
    ASSERT_EQ(forwards.set_keyframe(sequence_frame(0), SitePlane{kDepthMm}), TrackingReason::none);
    ASSERT_EQ(backwards.set_keyframe(sequence_frame(other), SitePlane{kDepthMm}),
              TrackingReason::none);
    const auto there = forwards.track(sequence_frame(other), {});
    const auto back = backwards.track(sequence_frame(0), {});
    ASSERT_NE(there.status, TrackingStatus::lost) << other;
    ASSERT_NE(back.status, TrackingStatus::lost) << other;
    const Eigen::Vector3d p = there.p_pivot_site_mm;
    const Eigen::Vector3d q = back.T_camera_site * (there.T_camera_site * p);
    EXPECT_LT(1000 * (q - p).head<2>().norm(), 0.5 * kPixelUm) << other;
  }
}

Features features_of(const std::string& file) {
  GreyAndMask images;
  make_grey_and_mask(cv::imread(test::opencv_data + file), ReflectionMaskParameters{}, images);
  FeatureParameters parameters;
  parameters.count = 2000;
  parameters.levels = 6;
  FeatureDetector detector(parameters);
  Features features;
  for (int i = 0; i < 10; ++i)
    detector.detect(images.grey, images.half, images.keep_half, features);
  return features;
}

TEST(GrafPair, MatchesAgreeWithTheTrueHomography) {
  const cv::FileStorage file(test::opencv_data + "H1to3p.xml", cv::FileStorage::READ);
  ASSERT_TRUE(file.isOpened()) << "install opencv-doc";
  cv::Mat H_true;
  file["H13"] >> H_true;
  const Features first = features_of("graf1.png"), third = features_of("graf3.png");
  const auto matches = match_all(first, third, MatchParameters{});
  ASSERT_GE(matches.size(), 60U);

  std::vector<cv::Point2f> from, to, expected;
  for (const Match& match : matches) {
    from.push_back(first.pixels[static_cast<std::size_t>(match.first)]);
    to.push_back(third.pixels[static_cast<std::size_t>(match.second)]);
  }
  cv::perspectiveTransform(from, expected, H_true);
  int right = 0;
  for (std::size_t i = 0; i < to.size(); ++i) right += cv::norm(expected[i] - to[i]) < 4 ? 1 : 0;
  EXPECT_GT(right, static_cast<int>(matches.size()) / 2);

  const cv::Mat H = cv::findHomography(from, to, cv::RANSAC, 3);
  ASSERT_FALSE(H.empty());
  std::vector<cv::Point2f> ours, grid, truth;
  for (float y = 200; y <= 450; y += 50)
    for (float x = 200; x <= 600; x += 50) grid.emplace_back(x, y);
  cv::perspectiveTransform(grid, ours, H);
  cv::perspectiveTransform(grid, truth, H_true);
  for (std::size_t i = 0; i < grid.size(); ++i)
    EXPECT_LT(cv::norm(ours[i] - truth[i]), 8) << grid[i];
}

}  // namespace
}  // namespace holdfast::perception
