// SPDX-License-Identifier: Apache-2.0
// A projector beside a camera over a smooth relief, drawn without either's code: is it found again,
// and is the next pattern changed where the surface is poor, by what is wrong there?
#include "registration/pattern_refinement.hpp"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "registration/pixel_reason.hpp"

namespace holdfast::registration {
namespace {

constexpr int kWidth = 960, kHeight = 768;
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

struct Scene {
  Rectification geometry;
  cv::Mat1b pattern, left;
  Reconstruction surface;
  cv::Matx34d P_true;

  explicit Scene(double roll_rad = 0, std::uint64_t seed = 1) {
    geometry.size_px = {kWidth, kHeight};
    geometry.P1 = {4000, 0, 480, 0, 0, 4000, 384, 0, 0, 0, 1, 0};
    geometry.P2 = {4000, 0, 480, -4000.0 * 24, 0, 4000, 384, 0, 0, 0, 1, 0};
    pattern = make_pattern({PatternKind::aperiodic, 4, 4, seed});
    cv::Matx33d R;
    cv::Rodrigues(cv::Vec3d(0.05, -0.18, roll_rad), R);
    const cv::Matx33d K(1250, 0, 402, 0, 1250, 305, 0, 0, 1);
    const cv::Vec3d t = -(R * cv::Vec3d(-36, -9, 4));
    cv::Matx34d T;
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) T(r, c) = R(r, c);
      T(r, 3) = t[r];
    }
    P_true = K * T;
    make_surface();
    shine();
  }

  [[nodiscard]] cv::Point2d lit_from(const cv::Vec3f& p) const {
    const cv::Vec3d q = P_true * cv::Vec4d(static_cast<double>(p[0]), static_cast<double>(p[1]),
                                           static_cast<double>(p[2]), 1);
    return {q[0] / q[2], q[1] / q[2]};
  }
  void forget(const cv::Rect& part) {
    surface.depth_mm(part).setTo(static_cast<double>(kNan));
    surface.depth_variance_mm2(part).setTo(static_cast<double>(kNan));
    surface.points_mm(part).setTo(cv::Scalar::all(static_cast<double>(kNan)));
    surface.reasons(part).setTo(static_cast<uchar>(PixelReason::unmatched));
  }
  /// Of the square of the pattern that lights this pixel of the unspoilt scene.
  [[nodiscard]] PatternNeed need_at(const PatternNeeds& needs, cv::Point pixel) const {
    const cv::Point2d lit = lit_from(point(pixel));
    return static_cast<PatternNeed>(
        needs.cells(static_cast<int>(lit.y) / kNeedCellPx, static_cast<int>(lit.x) / kNeedCellPx));
  }

 private:
  [[nodiscard]] static cv::Vec3f point(cv::Point pixel) {
    const double z =
        200 + 3 * std::sin(0.008 * pixel.x + 0.3) * std::cos(0.007 * pixel.y) + 0.003 * pixel.x;
    return cv::Vec3d((pixel.x - 480) / 4000.0 * z, (pixel.y - 384) / 4000.0 * z, z);
  }
  void make_surface() {
    const cv::Size size(kWidth, kHeight);
    surface.status = ReconstructionStatus::done;
    surface.region_px = {0, 0, kWidth, kHeight};
    surface.nearest_mm = 180;
    surface.farthest_mm = 220;
    surface.depth_mm.create(size);
    surface.points_mm.create(size);
    surface.depth_variance_mm2 = cv::Mat1f(size, 0.03F * 0.03F);
    surface.reasons = cv::Mat1b(size, static_cast<uchar>(PixelReason::known));
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < kWidth; ++x) {
        surface.points_mm(y, x) = point({x, y});
        surface.depth_mm(y, x) = surface.points_mm(y, x)[2];
      }
  }
  void shine() {
    cv::Mat1f u(kHeight, kWidth), v(kHeight, kWidth), lit;
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < kWidth; ++x) {
        const cv::Point2d at = lit_from(point({x, y}));
        u(y, x) = static_cast<float>(at.x);
        v(y, x) = static_cast<float>(at.y);
      }
    cv::Mat1f source, noise(kHeight, kWidth);
    pattern.convertTo(source, CV_32F, 0.5, 20);
    cv::GaussianBlur(source, source, {}, 0.6);
    cv::remap(source, lit, u, v, cv::INTER_LINEAR);
    cv::RNG random(7);
    random.fill(noise, cv::RNG::NORMAL, 0, 3);
    cv::add(lit, noise, left, cv::noArray(), CV_8U);
  }
};

TEST(ProjectorMap, IsFoundFromOneViewUnderAKnownPattern) {
  for (const double roll_rad : {0.0, 0.12}) {
    const Scene scene(roll_rad);
    const ProjectorMap map = find_projector(scene.pattern, scene.left, scene.surface);
    ASSERT_TRUE(map.is_found) << map.evidence;
    EXPECT_GE(map.anchors, 80);
    double worst = 0;
    for (int y = 20; y < kHeight; y += 60)
      for (int x = 20; x < kWidth; x += 60) {
        const cv::Vec3f& p = scene.surface.points_mm(y, x);
        worst = std::max(worst, cv::norm(map.project(p) - scene.lit_from(p)));
      }
    EXPECT_LT(worst, 1.0) << "projector pixels, roll " << roll_rad;
  }
}

TEST(ProjectorMap, IsNotFoundUnderAnotherPattern) {
  const Scene scene;
  ProjectorLimits limits;
  limits.search = {2.8, 3.4, 0.09};  // near the truth (3.1), so that the search is short
  ASSERT_TRUE(find_projector(scene.pattern, scene.left, scene.surface, limits).is_found);
  const cv::Mat1b other = make_pattern({PatternKind::aperiodic, 4, 4, 2});
  const ProjectorMap map = find_projector(other, scene.left, scene.surface, limits);
  EXPECT_FALSE(map.is_found);
  EXPECT_EQ(map.evidence, "0 parts of the image were found in the pattern, must be 40");
}

/// The scene with a place of each fault, and what the next pattern is told of it.
class Needs : public testing::Test {
 protected:
  static constexpr int kHole = 140;
  void SetUp() override {
    const auto spoil = [this](const cv::Rect& place) {
      scene_.forget(place);
      return scene_.left(place);
    };
    spoil(place(other_));
    cv::Mat1b faint = spoil(place(faint_));
    faint = faint * 0.2 + 36;
    spoil(place(saturated_)).setTo(255);
    scene_.surface.depth_variance_mm2(place(uncertain_)).setTo(0.3 * 0.3);
    map_.is_found = true;
    map_.projection = scene_.P_true;
    needs_ = pattern_needs({scene_.surface, scene_.geometry, scene_.left, scene_.pattern, map_});
  }
  static cv::Rect place(cv::Point middle) {
    return {middle.x - kHole / 2, middle.y - kHole / 2, kHole, kHole};
  }
  Scene scene_;
  ProjectorMap map_;
  PatternNeeds needs_;
  const cv::Point good_{480, 200}, other_{150, 150}, faint_{400, 500}, saturated_{800, 150},
      uncertain_{800, 600};
};

TEST_F(Needs, AreToldByWhatIsWrong) {
  EXPECT_EQ(scene_.need_at(needs_, good_), PatternNeed::none);
  EXPECT_EQ(scene_.need_at(needs_, other_), PatternNeed::other);
  EXPECT_EQ(scene_.need_at(needs_, faint_), PatternNeed::faint);
  EXPECT_EQ(scene_.need_at(needs_, saturated_), PatternNeed::saturated);
  EXPECT_EQ(scene_.need_at(needs_, uncertain_), PatternNeed::other);
  int needy = 0;
  for (std::size_t need = 1; need < kNeeds; ++need) needy += needs_.count.at(need);
  EXPECT_GT(needy, 120);  // five places of some 31 squares, and their rims
  EXPECT_LT(needy, 260);
}

TEST_F(Needs, WithoutDotsInAPoorPlaceItIsAGap) {
  cv::Mat1b before = scene_.pattern.clone();
  const cv::Point2d lit =
      scene_.lit_from({(150 - 480) / 4000.F * 200, (150 - 384) / 4000.F * 200, 201.F});
  before(cv::Rect(static_cast<int>(lit.x) - 40, static_cast<int>(lit.y) - 40, 80, 80)).setTo(0);
  const PatternNeeds needs =
      pattern_needs({scene_.surface, scene_.geometry, scene_.left, before, map_});
  EXPECT_EQ(scene_.need_at(needs, other_), PatternNeed::gap);
  EXPECT_EQ(scene_.need_at(needs, good_), PatternNeed::none) << "a gap that did no harm";
}

TEST_F(Needs, TheNextPatternAnswersThem) {
  const PatternParameters next{PatternKind::aperiodic, 4, 4, 2};
  const cv::Mat1b image = refined_pattern(next, scene_.pattern, needs_);
  EXPECT_EQ(cv::countNonZero(image != refined_pattern(next, scene_.pattern, needs_)), 0);
  double brightest_dimmed = 0, brightest_faint = 0;
  for (int row = 0; row < needs_.cells.rows; ++row)
    for (int column = 0; column < needs_.cells.cols; ++column) {
      const auto need = static_cast<PatternNeed>(needs_.cells(row, column));
      double most = 0;  // in the middle of the square, which no neighbour's dot reaches
      cv::minMaxLoc(image(cv::Rect(column * kNeedCellPx + 3, row * kNeedCellPx + 3, 2, 2)), nullptr,
                    &most);
      if (need == PatternNeed::saturated) brightest_dimmed = std::max(brightest_dimmed, most);
      if (need == PatternNeed::faint) brightest_faint = std::max(brightest_faint, most);
    }
  EXPECT_NEAR(brightest_dimmed, 128, 1);
  EXPECT_NEAR(brightest_faint, 255, 1);
}

TEST(RefinedPattern, LightsWhatWasDarkAndLeavesWhatWasLit) {
  const PatternParameters first{PatternKind::aperiodic, 4, 4, 1},
      next{PatternKind::aperiodic, 4, 4, 2};
  const cv::Mat1b before = make_pattern(first);
  const cv::Mat1b image = complementary_pattern(next, before);
  const auto lit_in_both = [&](const cv::Mat1b& other) {
    return cv::countNonZero((before > 200) & (other > 200)) /
           static_cast<double>(cv::countNonZero(before > 200));
  };
  EXPECT_GT(lit_in_both(make_pattern(next)), 0.15);  // by chance
  EXPECT_LT(lit_in_both(image), 0.06);
  EXPECT_NEAR(cv::mean(image)[0], cv::mean(before)[0], 0.15 * cv::mean(before)[0]);
}

TEST(RefinedPattern, HasLargerDotsWhereTheyWereFaintAndStaysWithinTheLimits) {
  PatternNeeds faint;
  faint.cells = cv::Mat1b(75, 100, static_cast<uchar>(PatternNeed::faint));
  const auto area_of_a_dot = [&](double dot_px, double distance_px) {
    const PatternParameters next{PatternKind::aperiodic, dot_px, distance_px, 2};
    const cv::Mat1b image = refined_pattern(next, make_pattern(next), faint);
    cv::Mat labels, stats, centres;
    const int blobs = cv::connectedComponentsWithStats(image > 127, labels, stats, centres) - 1;
    return cv::countNonZero(image > 127) / static_cast<double>(blobs);
  };
  EXPECT_NEAR(area_of_a_dot(4, 4), 0.785 * 6.4 * 6.4, 8);
  EXPECT_NEAR(area_of_a_dot(16, 10), 0.785 * 16 * 16, 16);
}

}  // namespace
}  // namespace holdfast::registration
