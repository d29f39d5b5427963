// SPDX-License-Identifier: Apache-2.0
#include "registration/pattern.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

namespace holdfast::registration {
namespace {

cv::Mat pattern(PatternKind kind, double dot_px, double distance_px, std::uint64_t seed = 1) {
  return make_pattern({kind, dot_px, distance_px, seed});
}

/// The strongest correlation of the image with itself moved along a row by 4 to 120 px.
double worst_self_similarity(const cv::Mat& image) {
  cv::Mat values;
  image.convertTo(values, CV_32F);
  values -= cv::mean(values)[0];
  double worst = -1;
  for (int shift = 4; shift <= 120; ++shift) {
    const cv::Mat left = values.colRange(0, values.cols - shift);
    const cv::Mat right = values.colRange(shift, values.cols);
    worst = std::max(worst, left.dot(right) / std::sqrt(left.dot(left) * right.dot(right)));
  }
  return worst;
}

TEST(Pattern, LatticeHasItsPitchAndItsDotsTheirSize) {
  const cv::Mat image = pattern(PatternKind::lattice, 6, 4);
  ASSERT_EQ(image.size(), cv::Size(800, 600));
  EXPECT_EQ(cv::countNonZero(image != pattern(PatternKind::lattice, 6, 4)), 0);
  // 80 x 60 discs of 6 px.
  const double lit_px = cv::sum(image)[0] / 255;
  EXPECT_NEAR(lit_px / (80 * 60), 3.14159265 * 9, 1.0);
  EXPECT_EQ(cv::countNonZero(image(cv::Rect{0, 0, 780, 600}) != image(cv::Rect{10, 0, 780, 600})),
            0);
}

TEST(Pattern, OnlyTheLatticeRepeatsItself) {
  for (const double distance_px : {1.0, 4.0, 10.0}) {
    EXPECT_GT(worst_self_similarity(pattern(PatternKind::lattice, 5, distance_px)), 0.99);
    EXPECT_LT(worst_self_similarity(pattern(PatternKind::aperiodic, 5, distance_px)), 0.3);
    EXPECT_LT(worst_self_similarity(pattern(PatternKind::random, 5, distance_px)), 0.35);
  }
}

TEST(Pattern, AperiodicDotsStayApart) {
  const cv::Mat image = pattern(PatternKind::aperiodic, 6, 4);
  cv::Mat labels, stats, centres;
  const int blobs = cv::connectedComponentsWithStats(image > 127, labels, stats, centres) - 1;
  EXPECT_NEAR(blobs, 80 * 60 / 2, 120);  // even chance for each cell
  int merged = 0;
  for (int blob = 1; blob <= blobs; ++blob)
    merged += stats.at<int>(blob, cv::CC_STAT_WIDTH) > 7 ? 1 : 0;
  EXPECT_LT(merged, blobs / 50);
}

TEST(Pattern, SeedDecides) {
  EXPECT_EQ(cv::countNonZero(pattern(PatternKind::aperiodic, 4, 4, 7) !=
                             pattern(PatternKind::aperiodic, 4, 4, 7)),
            0);
  EXPECT_NE(cv::countNonZero(pattern(PatternKind::aperiodic, 4, 4, 7) !=
                             pattern(PatternKind::aperiodic, 4, 4, 8)),
            0);
}

TEST(Pattern, LimitsAreThePapers) {
  EXPECT_FALSE(invalid_pattern({PatternKind::lattice, 2, 1, 1}));
  EXPECT_FALSE(invalid_pattern({PatternKind::lattice, 16, 10, 1}));
  EXPECT_TRUE(invalid_pattern({PatternKind::lattice, 1.9, 1, 1}));
  EXPECT_TRUE(invalid_pattern({PatternKind::lattice, 16.1, 1, 1}));
  EXPECT_TRUE(invalid_pattern({PatternKind::lattice, 4, 0.9, 1}));
  EXPECT_TRUE(invalid_pattern({PatternKind::lattice, 4, 10.1, 1}));
  EXPECT_TRUE(
      invalid_pattern({PatternKind::lattice, std::numeric_limits<double>::quiet_NaN(), 4, 1}));
}

}  // namespace
}  // namespace holdfast::registration
