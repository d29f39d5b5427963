// SPDX-License-Identifier: Apache-2.0
#include "registration/zoom_seating.hpp"

#include <cmath>

#include <gtest/gtest.h>

namespace holdfast::registration {
namespace {

constexpr int kWidth = 2456, kHeight = 2054;

/// Zooms from 1.1 on whose right principal points follow a parabola in log zoom, but for `jumps`.
std::vector<ZoomCalibration> zooms_with(const std::vector<double>& jumps_px) {
  std::vector<ZoomCalibration> zooms;
  for (std::size_t i = 0; i < jumps_px.size(); ++i) {
    ZoomCalibration& zoom = zooms.emplace_back();
    zoom.zoom = 1.1 + 0.1 * static_cast<double>(i);
    zoom.focus_mm = 200;
    const double x = std::log(zoom.zoom / 1.1), f = 3000;
    zoom.camera_matrix_left = {f, 0, 1227.5, 0, f, 1026.5, 0, 0, 1};
    zoom.camera_matrix_right = {f, 0, 1220, 0, f, 1030 + 3 * x - 2 * x * x + jumps_px[i], 0, 0, 1};
    zoom.distortion_left = cv::Mat::zeros(1, 5, CV_64F);
    zoom.distortion_right = cv::Mat::zeros(1, 5, CV_64F);
    zoom.T = {-24, 0, 0};
  }
  return zooms;
}

TEST(LearntSeating, IsTheExpectedOneWhereZoomsAreTooFew) {
  EXPECT_DOUBLE_EQ(learnt_seating_px(zooms_with({0, 5, 0}), kWidth, kHeight, 0.15), 0.15);
}

TEST(LearntSeating, ZoomsInOneSmoothLineSpeakForLess) {
  const double learnt = learnt_seating_px(zooms_with({0, 0, 0, 0, 0}), kWidth, kHeight, 0.15);
  EXPECT_NEAR(learnt, 0.15 * std::sqrt(4.0 / 6.0), 1e-3);
}

TEST(LearntSeating, JumpsSpeakForMore) {
  EXPECT_GT(learnt_seating_px(zooms_with({1, -1, 1, -1, 1}), kWidth, kHeight, 0.15), 0.4);
}

}  // namespace
}  // namespace holdfast::registration
