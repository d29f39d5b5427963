// SPDX-License-Identifier: Apache-2.0
#include "rt/frame_intake.hpp"

#include <vector>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

namespace holdfast::rt {
namespace {

using bridge::CameraEvent;
using safety::Reason;
using namespace std::chrono_literals;

cv::Mat noise_image(int seed, int type = CV_8UC1) {
  cv::Mat image(120, 160, type);
  cv::RNG rng{static_cast<std::uint64_t>(seed)};
  rng.fill(image, cv::RNG::UNIFORM, 20, 200);
  return image;
}

bridge::CameraReport report(CameraEvent event, std::uint64_t id, const cv::Mat& image = {}) {
  bridge::CameraReport r;
  r.event = event;
  r.frame_id = id;
  r.t_received = 1s + id * 33ms;
  r.t_exposure = r.t_received - 10ms;
  r.image = image;
  return r;
}

std::vector<FrameArrival> drain(FrameIntake& intake) {
  std::vector<FrameArrival> all;
  FrameArrival arrival;
  while (intake.arrivals().try_pop(arrival)) all.push_back(arrival);
  return all;
}

/// The frame waiting for the tracker, or none: the intake is closed first, so it cannot wait.
bool has_waiting_frame(FrameIntake& intake) {
  IntakeFrame frame;
  intake.close();
  return intake.wait_frame(frame);
}

TEST(FrameIntake, HandsASoundFrameToControlAndTracker) {
  FrameIntake intake{{}};
  const cv::Mat image = noise_image(1);
  intake.on_report(report(CameraEvent::frame, 7, image));
  const auto arrivals = drain(intake);
  ASSERT_EQ(arrivals.size(), 1U);
  EXPECT_TRUE(arrivals[0].is_frame);
  EXPECT_TRUE(arrivals[0].faults.empty());
  EXPECT_EQ(arrivals[0].frame, 7U);
  IntakeFrame frame;
  ASSERT_TRUE(intake.wait_frame(frame));
  EXPECT_EQ(frame.frame, 7U);
  EXPECT_EQ(cv::norm(frame.image, image, cv::NORM_INF), 0);
}

TEST(FrameIntake, ReportsAFrozenFrameAndNeverTracksIt) {
  RecordProperty("requirement", "SR-61");
  FrameIntake intake{{}};
  const cv::Mat image = noise_image(1);
  intake.on_report(report(CameraEvent::frame, 1, image));
  IntakeFrame frame;
  ASSERT_TRUE(intake.wait_frame(frame));
  intake.on_report(report(CameraEvent::frame, 2, image.clone()));
  const auto arrivals = drain(intake);
  ASSERT_EQ(arrivals.size(), 2U);
  EXPECT_TRUE(arrivals[1].faults.contains(Reason::frame_frozen));
  EXPECT_FALSE(has_waiting_frame(intake));
}

TEST(FrameIntake, ReportsADarkAndASaturatedFrame) {
  RecordProperty("requirement", "SR-61");
  for (const auto& [level, reason] :
       {std::pair{0, Reason::frame_dark}, std::pair{255, Reason::frame_saturated}}) {
    FrameIntake intake{{}};
    intake.on_report(report(CameraEvent::frame, 1, cv::Mat(120, 160, CV_8UC1, cv::Scalar(level))));
    EXPECT_TRUE(drain(intake).at(0).faults.contains(reason)) << level;
    EXPECT_FALSE(has_waiting_frame(intake)) << level;
  }
}

TEST(FrameIntake, TranslatesEachCameraEvent) {
  const std::vector<std::pair<CameraEvent, Reason>> expected = {
      {CameraEvent::incomplete, Reason::frame_incomplete},
      {CameraEvent::gap, Reason::frame_gap},
      {CameraEvent::time_invalid, Reason::frame_time_invalid},
      {CameraEvent::disconnected, Reason::camera_disconnected}};
  for (const auto& [event, reason] : expected) {
    FrameIntake intake{{}};
    intake.on_report(report(event, 3));
    const FrameArrival arrival = drain(intake).at(0);
    EXPECT_FALSE(arrival.is_frame);
    EXPECT_TRUE(arrival.faults.contains(reason));
    EXPECT_EQ(arrival.is_connected, event != CameraEvent::disconnected);
  }
}

TEST(FrameIntake, CountsAFrameTheTrackerWasTooSlowFor) {
  FrameIntake intake{{}};
  intake.on_report(report(CameraEvent::frame, 1, noise_image(1)));
  intake.on_report(report(CameraEvent::frame, 2, noise_image(2)));
  EXPECT_EQ(intake.frames_skipped(), 1U);
  IntakeFrame frame;
  ASSERT_TRUE(intake.wait_frame(frame));
  EXPECT_EQ(frame.frame, 2U);
}

TEST(FrameIntake, ScalesTwelveBitFramesToEight) {
  FrameIntake intake{{}};
  cv::Mat image(120, 160, CV_16UC1, cv::Scalar(1600));
  image.at<std::uint16_t>(5, 5) = 3200;
  intake.on_report(report(CameraEvent::frame, 1, image));
  IntakeFrame frame;
  ASSERT_TRUE(intake.wait_frame(frame));
  EXPECT_EQ(frame.image.type(), CV_8UC1);
  EXPECT_EQ(frame.image.at<std::uint8_t>(0, 0), 100);
  EXPECT_EQ(frame.image.at<std::uint8_t>(5, 5), 200);
}

}  // namespace
}  // namespace holdfast::rt
