// SPDX-License-Identifier: Apache-2.0
// Real pairs with ground truth: the matcher with its defaults against OpenCV's SGBM in the same
// run.
#include "tests/registration/support/real_stereo.hpp"

#include <gtest/gtest.h>

namespace holdfast::registration {
namespace {

struct Both {
  test::DisparityErrors ours, opencv;
};

Both match(const test::RealStereo& pair) {
  MatchParameters parameters = match_parameters_for(pair.left.size());
  const DisparityRange range = whole_range(parameters, pair.range);
  const RectifiedPair views = test::matchable(pair, parameters, range);
  WorkerPool pool(2);
  Both both;
  both.ours = test::errors_of(
      match_disparity(std::span(&views, 1), range, parameters, pool).disparity_px, pair.truth_px);
  parameters.method = MatchMethod::opencv;
  both.opencv = test::errors_of(
      match_disparity(std::span(&views, 1), range, parameters, pool).disparity_px, pair.truth_px);
  return both;
}

TEST(RealStereo, MotorcycleHasFewerWrongAndFinerPixelsThanSgbm) {
  const test::RealStereo pair = test::motorcycle();
  ASSERT_FALSE(pair.truth_px.empty()) << "install python3-skimage";
  const Both both = match(pair);
  EXPECT_LT(both.ours.bad_2px, both.opencv.bad_2px);
  EXPECT_GT(both.ours.density, 0.85);  // SGBM's is 0.92
  EXPECT_LT(both.ours.median_px, 0.75 * both.opencv.median_px);
}

TEST(RealStereo, AloeHasFewerWrongPixelsThanSgbm) {
  const test::RealStereo pair = test::aloe();
  ASSERT_FALSE(pair.truth_px.empty()) << "install opencv-doc";
  const Both both = match(pair);
  EXPECT_LT(both.ours.bad_2px, both.opencv.bad_2px);
  EXPECT_GT(both.ours.density, 0.78);  // SGBM's is 0.86
}

}  // namespace
}  // namespace holdfast::registration
