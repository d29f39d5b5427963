// SPDX-License-Identifier: Apache-2.0
// Every AVX2 kernel gives the scalar reference's bits, and no result depends on the threads.
#include "registration/sgm.hpp"

#include <array>
#include <random>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "registration/census.hpp"
#include "registration/disparity_refinement.hpp"
#include "registration/rectified_image.hpp"

namespace holdfast::registration {
namespace {

/// Random numbers with structure: smoothed, so that matches exist.
cv::Mat1b random_image(int width, int height, std::uint64_t seed) {
  cv::Mat1b image(height, width);
  cv::RNG random(seed);
  random.fill(image, cv::RNG::UNIFORM, 0, 256);
  cv::GaussianBlur(image, image, {}, 1.2);
  cv::normalize(image, image, 0, 255, cv::NORM_MINMAX);
  return image;
}

/// `left` seen with right column = left column + shift(y).
struct Pair {
  cv::Mat1b left, right;
};
Pair shifted_pair(int width, int height, int candidates, int shift) {
  const cv::Mat1b scene = random_image(width + candidates, height, 7);
  Pair pair;
  pair.right = scene;
  pair.left = scene.colRange(shift, shift + width).clone();
  return pair;
}

template <typename T>
bool is_equal(const cv::Mat_<T>& a, const cv::Mat_<T>& b) {
  return a.size() == b.size() && cv::countNonZero(a.reshape(1) != b.reshape(1)) == 0;
}

#define REQUIRE_AVX2() \
  if (best_simd() != Simd::avx2) GTEST_SKIP() << "this CPU has no AVX2: nothing to compare"

TEST(Census, Avx2IsTheScalarReferenceToTheBit) {
  REQUIRE_AVX2();
  WorkerPool pool(1);
  const std::array shots = {random_image(83, 31, 1), random_image(83, 31, 2),
                            random_image(83, 31, 3)};
  for (const std::size_t count : {1UL, 3UL})
    for (const std::uint8_t threshold : {std::uint8_t{0}, std::uint8_t{9}}) {
      cv::Mat1i scalar, vector;
      census(std::span(shots.data(), count), threshold, pool, scalar, Simd::scalar);
      census(std::span(shots.data(), count), threshold, pool, vector, Simd::avx2);
      EXPECT_TRUE(is_equal(scalar, vector)) << count << " shots, threshold " << int{threshold};
    }
}

TEST(Census, IsBlindToExposureAndGain) {
  WorkerPool pool(1);
  const std::array original = {cv::Mat1b(random_image(64, 32, 4) / 4)};
  const std::array brighter = {cv::Mat1b(original[0] * 2 + 30)};
  cv::Mat1i a, b;
  census(original, 0, pool, a);
  census(brighter, 0, pool, b);
  EXPECT_TRUE(is_equal(a, b));
}

TEST(Census, FindsTheNoiseUnderTheTexture) {
  cv::Mat1f image(300, 400, 100.F), noise(300, 400);
  cv::RNG random(5);
  random.fill(noise, cv::RNG::NORMAL, 0, 3);
  cv::circle(image, {200, 150}, 80, 200, cv::FILLED);
  cv::Mat1b noisy;
  cv::Mat(image + noise).convertTo(noisy, CV_8U);
  EXPECT_NEAR(noise_of(noisy), 3, 0.3);
}

/// One path of random costs through all four loops, for `blocks` of candidates.
struct Loops {
  std::vector<std::uint8_t> cost, sum, gains[6], best_cost, margin;
  std::vector<std::int16_t> candidate;

  Loops(const sgm::Row& row, const std::int16_t* before_base, int right_width, Simd simd) {
    const auto count = static_cast<std::size_t>(row.width * row.blocks * sgm::kBlock);
    const auto padded = static_cast<std::size_t>((row.width + 2) * row.blocks * sgm::kBlock);
    std::mt19937 random(3);
    std::vector<std::int32_t> left(static_cast<std::size_t>(row.width)),
        right(static_cast<std::size_t>(right_width));
    for (auto& word : left) word = static_cast<std::int32_t>(random() >> 1);
    for (auto& word : right) word = static_cast<std::int32_t>(random() >> 1);
    for (std::size_t i = 0; i < left.size(); i += 3) left[i] = right[i + 5];
    cost.resize(count);
    sum.resize(count);
    for (auto& path : gains) path.resize(padded);
    const std::size_t margin_bytes = static_cast<std::size_t>(row.blocks) * sgm::kBlock;
    for (int path = 0; path < 3; ++path)
      for (std::size_t i = margin_bytes; i + margin_bytes < padded; ++i)
        gains[path][i] = static_cast<std::uint8_t>(random() % 25);
    candidate.resize(left.size());
    best_cost.resize(left.size());
    margin.resize(left.size());
    const sgm::Penalties penalties;
    cost_row(row, left.data(), right.data(), cost.data(), simd);
    aggregate_along(row, cost.data(), penalties, sum.data(), simd);
    aggregate_down(row, before_base, cost.data(), penalties,
                   {gains[0].data(), gains[1].data(), gains[2].data()},
                   {gains[3].data(), gains[4].data(), gains[5].data()}, sum.data(), simd);
    choose(row, cost.data(), sum.data(), {candidate.data(), best_cost.data(), margin.data()}, simd);
  }
};

void expect_same(const Loops& a, const Loops& b, int blocks) {
  EXPECT_EQ(a.cost, b.cost) << blocks << " blocks";
  EXPECT_EQ(a.sum, b.sum) << blocks << " blocks";
  for (int i = 3; i < 6; ++i) EXPECT_EQ(a.gains[i], b.gains[i]) << blocks << " blocks, path " << i;
  EXPECT_EQ(a.candidate, b.candidate) << blocks << " blocks";
  EXPECT_EQ(a.best_cost, b.best_cost) << blocks << " blocks";
  EXPECT_EQ(a.margin, b.margin) << blocks << " blocks";
}

TEST(SgmRows, Avx2IsTheScalarReferenceToTheBitForEveryNumberOfBlocks) {
  REQUIRE_AVX2();
  for (int blocks = 1; blocks <= sgm::kBlocksMax; ++blocks) {
    const sgm::Row row{34, blocks, nullptr};
    const int right_width = 34 + 16 * blocks;
    expect_same(Loops(row, nullptr, right_width, Simd::scalar),
                Loops(row, nullptr, right_width, Simd::avx2), blocks);
  }
}

TEST(SgmRows, Avx2IsTheScalarReferenceToTheBitWithWindows) {
  REQUIRE_AVX2();
  std::mt19937 random(11);
  std::vector<std::int16_t> base(34), before(34);
  for (std::size_t i = 0; i < base.size(); ++i) {
    base[i] = static_cast<std::int16_t>(i % 7 == 0 ? random() % 60 : 30 + random() % 4);
    before[i] = static_cast<std::int16_t>(30 + random() % 20);
  }
  const sgm::Row row{34, 1, base.data()};
  expect_same(Loops(row, before.data(), 34 + 80, Simd::scalar),
              Loops(row, before.data(), 34 + 80, Simd::avx2), 1);
}

TEST(Sgm, FindsAShiftWithAllCandidatesAndInWindows) {
  WorkerPool pool(2);
  const Pair pair = shifted_pair(96, 40, 64, 37);
  cv::Mat1i left, right;
  census(std::span(&pair.left, 1), 0, pool, left);
  census(std::span(&pair.right, 1), 0, pool, right);
  sgm::LevelResult all, windows;
  match_level(left, right, 4, {}, {}, pool, all);
  match_level(left, right, 4, cv::Mat1s(40, 96, std::int16_t{30}), {}, pool, windows);
  for (int x = 8; x < 88; ++x) {
    EXPECT_NEAR(all.candidate_16ths(20, x), 37 * 16, 8) << x;
    EXPECT_NEAR(windows.candidate_16ths(20, x), 37 * 16, 8) << x;
  }
}

TEST(Sgm, DoesNotDependOnThreadsOrInstructionSet) {
  REQUIRE_AVX2();
  const Pair pair = shifted_pair(128, 300, 32, 11);
  WorkerPool one(1), three(3);
  cv::Mat1i left, right;
  census(std::span(&pair.left, 1), 0, one, left);
  census(std::span(&pair.right, 1), 0, one, right);
  sgm::LevelResult a, b, c;
  match_level(left, right, 2, {}, {}, one, a);
  match_level(left, right, 2, {}, {}, three, b);
  match_level(left, right, 2, {}, {}, three, c, Simd::scalar);
  EXPECT_TRUE(is_equal(a.candidate_16ths, b.candidate_16ths));
  EXPECT_TRUE(is_equal(a.margin, b.margin));
  EXPECT_TRUE(is_equal(a.candidate_16ths, c.candidate_16ths));
  EXPECT_TRUE(is_equal(a.cost, c.cost));
}

TEST(Refinement, Avx2IsTheScalarReferenceToTheBit) {
  REQUIRE_AVX2();
  WorkerPool one(1), two(2);
  const Pair pair = shifted_pair(101, 120, 32, 11);
  const ShotPair shot{pair.left, pair.right};
  cv::Mat1i start(120, 101, 11 * 256 + 60);
  start(cv::Rect(20, 20, 5, 40)) = kNoOffset;
  RefinedOffsets scalar, vector;
  refine_offsets(std::span(&shot, 1), start, {}, one, scalar, Simd::scalar);
  refine_offsets(std::span(&shot, 1), start, {}, two, vector, Simd::avx2);
  cv::patchNaNs(scalar.offset_px, -1);
  cv::patchNaNs(vector.offset_px, -1);
  cv::patchNaNs(scalar.variance_px2, -1);
  cv::patchNaNs(vector.variance_px2, -1);
  EXPECT_TRUE(is_equal(scalar.offset_px, vector.offset_px));
  EXPECT_TRUE(is_equal(scalar.variance_px2, vector.variance_px2));
  EXPECT_NEAR(vector.offset_px(60, 50), 11, 0.01);
  EXPECT_EQ(vector.offset_px(40, 22), -1) << "unknown stays unknown";
}

TEST(Rectifier, Avx2IsTheScalarReferenceToTheBit) {
  REQUIRE_AVX2();
  const cv::Mat1b raw = random_image(160, 120, 9);
  const cv::Matx33d camera(400, 0, 80, 0, 400, 60, 0, 0, 1);
  const cv::Matx34d projection(390, 0, 78, 0, 0, 390, 61, 0, 0, 0, 1, 0);
  cv::Matx33d R_;
  R_ = cv::Matx33d(1, 0, 0.02, 0, 1, 0.01, -0.02, -0.01, 1);
  const cv::Mat distortion = (cv::Mat_<double>(1, 5) << -0.2, 0.1, 0.001, 0, 0);
  const Rectifier rectifier(camera, distortion, R_, projection, raw.size(), {-20, -10, 211, 143});
  WorkerPool one(1), two(2);
  RectifiedImage scalar, vector;
  rectifier.apply(raw, one, scalar, Simd::scalar);
  rectifier.apply(raw, two, vector, Simd::avx2);
  EXPECT_TRUE(is_equal(scalar.pixels, vector.pixels));
  EXPECT_EQ(scalar.covered, vector.covered);
  EXPECT_EQ(vector.covered.front(), cv::Range(0, 0)) << "above the raw image";
  EXPECT_GT(vector.covered[70].start, 0);
  EXPECT_LT(vector.covered[70].end, 211);
}

}  // namespace
}  // namespace holdfast::registration
