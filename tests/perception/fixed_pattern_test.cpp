// SPDX-License-Identifier: Apache-2.0
// What is fixed to the microscope must not vote for "no motion": projected dots over a site that
// moves below them, dense or sparse, from the keyframe on.
#include <chrono>
#include <cmath>
#include <string>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "perception/direct_tracker.hpp"
#include "perception/tracker_parameters.hpp"
#include "tests/perception/support/moving_scene.hpp"

namespace holdfast::perception {
namespace {

constexpr int kWidthPx = 960, kHeightPx = 540;
constexpr double kDepthMm = 200;
const Eigen::Isometry3d kStill = Eigen::Isometry3d::Identity();

Eigen::Isometry3d shifted(double x_mm, double y_mm) {
  return test::moved_about({0, 0, kDepthMm}, {x_mm, y_mm, 0}, {0, 0, 0});
}

/// Round dots at the places of a jittered lattice.
cv::Mat with_dots(const cv::Mat& image, int pitch_px) {
  constexpr double kGrey = 110;
  cv::Mat light(image.size(), CV_32F, cv::Scalar(0));
  cv::RNG random(5);
  const int jitter = pitch_px / 4;
  for (int y = pitch_px / 2; y < image.rows; y += pitch_px)
    for (int x = pitch_px / 2; x < image.cols; x += pitch_px)
      cv::circle(light, {x + random.uniform(-jitter, jitter), y + random.uniform(-jitter, jitter)},
                 4, cv::Scalar(kGrey), cv::FILLED, cv::LINE_AA);
  cv::GaussianBlur(light, light, {5, 5}, 1.2);
  cv::Mat sum;
  image.convertTo(sum, CV_32F);
  sum += light;
  sum.convertTo(sum, CV_8U);
  return sum;
}

struct Pattern {
  const char* label;
  int pitch_px;
  bool has_room;  ///< between its dots, for patches
};

class FixedPattern : public ::testing::TestWithParam<Pattern> {
 protected:
  /// The site moves away at 2 mm/s under a pattern that stays, seen 30 times a second.
  template <typename Judge>
  void follow(const TrackerParameters& parameters, const Judge& judge) {
    const CameraModel camera = test::microscope_camera(kWidthPx, kHeightPx);
    const test::MovingScene scene(camera, 0.5 * test::photograph(), kDepthMm);
    const auto seen = [&](const Eigen::Isometry3d& T, std::uint64_t seed) {
      return with_dots(scene.image(T, 2, seed), GetParam().pitch_px);
    };
    DirectTracker tracker(camera, parameters);
    ASSERT_EQ(tracker.set_keyframe(seen(kStill, 1000), SitePlane{kDepthMm}), TrackingReason::none);
    constexpr int kFrames = 15;
    for (int i = 1; i <= kFrames; ++i) {
      const double x_mm = 0.067 * i, y_mm = -0.02 * i;
      const auto e = tracker.track(seen(shifted(x_mm, y_mm), static_cast<std::uint64_t>(i)),
                                   std::chrono::milliseconds(33 * i));
      judge(e, std::hypot(e.dx_um - 1000 * x_mm, e.dy_um - 1000 * y_mm));
    }
  }
};

TEST_P(FixedPattern, WithoutTheCheckItVotesForStandingStill) {
  TrackerParameters parameters;
  parameters.health.change_share_max = 2;
  int wrong = 0;
  follow(parameters, [&](const MotionEstimate& e, double error_um) {
    wrong += e.status != TrackingStatus::lost && error_um > 200;
  });
  EXPECT_GT(wrong, 0) << "no danger left to guard against: the next test proves nothing";
}

TEST_P(FixedPattern, TheSiteIsFollowedBelowItOrLost) {
  RecordProperty("requirement", "SR-112");
  int followed = 0;
  follow(TrackerParameters{}, [&](const MotionEstimate& e, double error_um) {
    if (e.status == TrackingStatus::lost) return;
    // What covers all is noticed once the rest has moved by more than its grain.
    EXPECT_LT(error_um, GetParam().has_room ? 5 : CheckParameters{}.limit_um)
        << name(e.status) << ' ' << name(e.reason);
    ++followed;
  });
  EXPECT_GE(followed, GetParam().has_room ? 15 : 0);
  EXPECT_LE(followed, GetParam().has_room ? 15 : 2);
}

INSTANTIATE_TEST_SUITE_P(Dots, FixedPattern,
                         ::testing::Values(Pattern{"Sparse", 60, true}, Pattern{"Dense", 36, true},
                                           Pattern{"CoveringAll", 20, false}),
                         [](const auto& param_info) {
                           return std::string(param_info.param.label);
                         });

/// A site at rest, and what may happen to its image.
struct Disturbance {
  const char* label;
  void (*apply)(cv::Mat& image);
};

class StillSite : public ::testing::TestWithParam<Disturbance> {};

TEST_P(StillSite, IsNotContradicted) {
  const CameraModel camera = test::microscope_camera(kWidthPx, kHeightPx);
  const test::MovingScene scene(camera, 0.7 * test::photograph(), kDepthMm);
  DirectTracker tracker(camera, TrackerParameters{});
  ASSERT_EQ(tracker.set_keyframe(scene.image(kStill, 2, 1), SitePlane{kDepthMm}),
            TrackingReason::none);
  cv::Mat image = scene.image(kStill, 2, 2);
  GetParam().apply(image);
  const auto e = tracker.track(image, {});
  EXPECT_NE(e.status, TrackingStatus::lost) << name(e.reason);
  EXPECT_LT(std::hypot(e.dx_um, e.dy_um), 2);
}

INSTANTIATE_TEST_SUITE_P(
    Disturbances, StillSite,
    ::testing::Values(Disturbance{"None", [](cv::Mat&) {}},
                      Disturbance{"Dimmer", [](cv::Mat& m) { m.convertTo(m, -1, 0.6, 4); }},
                      Disturbance{"Blurred",
                                  [](cv::Mat& m) {
                                    cv::GaussianBlur(m, m, {0, 0}, 1.5);
                                  }},
                      Disturbance{"LitFromOneSide",
                                  [](cv::Mat& m) {
                                    for (int x = 0; x < m.cols; ++x)
                                      m.col(x) *= 0.6 + 0.5 * x / m.cols;
                                  }},
                      Disturbance{"InstrumentOverAThird",
                                  [](cv::Mat& m) { m.colRange(0, m.cols / 3) = 90; }}),
    [](const auto& param_info) { return std::string(param_info.param.label); });

}  // namespace
}  // namespace holdfast::perception
