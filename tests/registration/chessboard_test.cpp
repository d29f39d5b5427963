// SPDX-License-Identifier: Apache-2.0
#include "registration/chessboard.hpp"

#include <cmath>
#include <string>

#include <gtest/gtest.h>

#include "tests/registration/support/flat_render.hpp"

namespace holdfast::registration {
namespace {

constexpr BoardPattern kBoard;

test::FlatView view(double tilt_x = 0.3, double tilt_y = -0.25, double turn = 0.1) {
  test::FlatView v;
  v.T_camera_plane = Eigen::Translation3d(1, -0.5, 200) *
                     Eigen::AngleAxisd(tilt_y, Eigen::Vector3d::UnitY()) *
                     Eigen::AngleAxisd(tilt_x, Eigen::Vector3d::UnitX()) *
                     Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitZ());
  return v;
}

/// A board of 10x6 squares on white.
double print(double x, double y) {
  const double s = kBoard.square_mm, u = x / s + 5, v = y / s + 3;
  if (u < 0 || v < 0 || u >= 10 || v >= 6) return 210;
  const bool is_dark = (static_cast<int>(u) + static_cast<int>(v)) % 2 == 0;
  return is_dark ? 40 : 200;
}

double rms_px(const test::FlatView& v, const std::vector<cv::Point2d>& corners) {
  double ahead = 0, turned = 0;
  const auto points = kBoard.points_mm();
  for (std::size_t i = 0; i < points.size(); ++i) {
    ahead += std::pow(cv::norm(corners[i] - v.pixel(points[i])), 2);
    turned += std::pow(cv::norm(corners[points.size() - 1 - i] - v.pixel(points[i])), 2);
  }
  return std::sqrt(std::min(ahead, turned) / static_cast<double>(points.size()));
}

TEST(FindChessboard, FindsEveryCornerToAFewHundredthsOfAPixel) {
  for (const double blur : {0.7, 2.0}) {
    test::FlatView v = view();
    v.blur_px = blur;
    const auto found = find_chessboard(test::render(v, print), kBoard);
    ASSERT_EQ(found.corners.size(), 45U);
    EXPECT_LT(rms_px(v, found.corners), 0.03) << "blur " << blur;
  }
}

TEST(FindChessboard, UnevenLightDoesNotPullTheCorners) {
  const test::FlatView v = view();
  const auto lit = [](double x, double y) { return print(x, y) * (0.75 + 0.015 * x); };
  const auto found = find_chessboard(test::render(v, lit), kBoard);
  ASSERT_EQ(found.corners.size(), 45U);
  EXPECT_LT(rms_px(v, found.corners), 0.04);
}

TEST(FindChessboard, ABoardPartlyOutOfViewIsNotFound) {
  test::FlatView v = view(0, 0, 0);
  v.T_camera_plane.translation().x() = 18;
  const auto found = find_chessboard(test::render(v, print), kBoard);
  EXPECT_TRUE(found.corners.empty());
  EXPECT_GT(found.seen.area(), 0);
  EXPECT_LT(found.seen.area(), 45);
}

TEST(FindChessboard, SaysWhatBoardItSeesWhenAskedForAnother) {
  BoardPattern other;
  other.columns = 8;
  other.rows = 6;
  const auto found = find_chessboard(test::render(view(0, 0, 0), print), other);
  EXPECT_TRUE(found.corners.empty());
  EXPECT_EQ(std::max(found.seen.width, found.seen.height), 9);
  EXPECT_EQ(std::min(found.seen.width, found.seen.height), 5);
}

TEST(FindChessboard, FindsNoBoardOnAPlainImage) {
  const auto found = find_chessboard(cv::Mat(480, 640, CV_8U, cv::Scalar(128)), kBoard);
  EXPECT_TRUE(found.corners.empty());
  EXPECT_EQ(found.seen.area(), 0);
}

TEST(MatchCornerOrder, UndoesAHalfTurn) {
  std::vector<cv::Point2d> left, right;
  for (const auto& p : kBoard.points_mm()) {
    left.emplace_back(p.x(), p.y());
    right.emplace_back(p.x() - 3, p.y() + 1);
  }
  auto turned = right;
  std::reverse(turned.begin(), turned.end());
  match_corner_order(kBoard, left, turned);
  EXPECT_EQ(turned, right);
  match_corner_order(kBoard, left, turned);
  EXPECT_EQ(turned, right);
}

}  // namespace
}  // namespace holdfast::registration
