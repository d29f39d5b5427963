// SPDX-License-Identifier: Apache-2.0
// Lattices of every pitch are known by their pixels, turned, stretched, noisy and shaded; patterns
// that do not repeat are not taken for one.
#include "registration/pattern_lattice.hpp"

#include <cmath>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "registration/pattern.hpp"

namespace holdfast::registration {
namespace {

/// The projector's image as a camera sees it: enlarged, turned, in perspective, out of focus, on
/// skin that shades it and has marks of its own, with noise.
cv::Mat1b seen(const PatternParameters& parameters, double scale, double turn_rad, int seed) {
  constexpr double kTilt = 2e-4;  // the pitch changes by a sixth across the image
  const cv::Size size(820, 684);
  const double c = scale * std::cos(turn_rad), s = scale * std::sin(turn_rad);
  const cv::Matx33d about_middle(1, 0, -400, 0, 1, -300, 0, 0, 1),
      turn(c, -s, 0, s, c, 0, kTilt, 0, 1),
      to_middle(1, 0, size.width / 2.0, 0, 1, size.height / 2.0, 0, 0, 1);
  cv::Mat image, albedo(size, CV_32F), noise(size, CV_32F);
  cv::warpPerspective(make_pattern(parameters), image, to_middle * turn * about_middle, size,
                      cv::INTER_AREA);
  cv::GaussianBlur(image, image, {}, 1);
  cv::RNG random(static_cast<std::uint64_t>(seed));
  random.fill(albedo, cv::RNG::NORMAL, 0, 1);
  cv::GaussianBlur(albedo, albedo, {}, 6);
  random.fill(noise, cv::RNG::NORMAL, 0, 2);
  cv::Mat1b result(size);
  for (int y = 0; y < size.height; ++y)
    for (int x = 0; x < size.width; ++x) {
      const double lit = 0.3 + 0.7 * x / size.width;
      const double skin = 1 + 2 * static_cast<double>(albedo.at<float>(y, x));
      const double grey = lit * skin * (15 + 0.4 * image.at<uchar>(y, x));
      result(y, x) = cv::saturate_cast<uchar>(grey + static_cast<double>(noise.at<float>(y, x)));
    }
  return result;
}

struct Dots {
  double dot_px, distance_px, scale, turn_rad;
};
constexpr Dots kDots[] = {{2, 1, 3, 0},    {2, 4, 2, 0.1},  {2, 10, 3, 0}, {4, 4, 1, 0.3},
                          {4, 4, 3, 0.05}, {16, 1, 2, 0.1}, {10, 6, 3, 0}, {16, 10, 2, 0}};

TEST(PatternLattice, IsKnownWhateverItsDots) {
  RecordProperty("requirement", "SR-96");
  WorkerPool pool(2);
  for (const Dots& dots : kDots) {
    const cv::Mat1b image = seen({PatternKind::lattice, dots.dot_px, dots.distance_px, 1},
                                 dots.scale, dots.turn_rad, 1);
    EXPECT_GT(repetition_of(image, pool).share, kRepetitionMax)
        << dots.dot_px << ", " << dots.distance_px << " px apart, x " << dots.scale;
  }
}

TEST(PatternLattice, IsNotSeenInPatternsThatDoNotRepeat) {
  WorkerPool pool(2);
  for (const Dots& dots : kDots)
    for (const PatternKind kind : {PatternKind::aperiodic, PatternKind::random})
      for (int seed = 1; seed <= 2; ++seed) {
        const cv::Mat1b image =
            seen({kind, dots.dot_px, dots.distance_px, static_cast<std::uint64_t>(seed)},
                 dots.scale, dots.turn_rad, seed);
        EXPECT_LT(repetition_of(image, pool).share, kRepetitionMax)
            << dots.dot_px << ", " << dots.distance_px << " px apart, x " << dots.scale;
      }
}

TEST(PatternLattice, StepIsThePitch) {
  WorkerPool pool(2);
  const ImageRepetition found = repetition_of(make_pattern({PatternKind::lattice, 6, 8, 1}), pool);
  EXPECT_GT(found.share, 0.95);
  const double across = found.step_px.x / 14, down = found.step_px.y / 14;
  EXPECT_NEAR(across, std::round(across), 0.15);
  EXPECT_NEAR(down, std::round(down), 0.15);
  EXPECT_GT(found.parts, 3);
}

TEST(PatternLattice, SaysNothingOfImagesWithoutTexture) {
  WorkerPool pool(1);
  cv::Mat1f noise(400, 600);
  cv::RNG random(3);
  random.fill(noise, cv::RNG::NORMAL, 40, 2);
  cv::Mat1b image;
  noise.convertTo(image, CV_8U);
  EXPECT_LT(repetition_of(image, pool).share, 0.3);
  const ImageRepetition flat = repetition_of(cv::Mat1b(400, 600, uchar{90}), pool);
  EXPECT_EQ(flat.share, 0);
  EXPECT_EQ(flat.parts, 0);
  EXPECT_EQ(repetition_of(cv::Mat1b(20, 30, uchar{90}), pool).share, 0);
}

TEST(PatternLattice, DoesNotDependOnTheThreads) {
  const cv::Mat1b image = seen({PatternKind::aperiodic, 4, 4, 1}, 3, 0, 1);
  WorkerPool one(1), five(5);
  const ImageRepetition a = repetition_of(image, one), b = repetition_of(image, five);
  EXPECT_EQ(a.share, b.share);
  EXPECT_EQ(a.step_px, b.step_px);
}

}  // namespace
}  // namespace holdfast::registration
