// SPDX-License-Identifier: Apache-2.0
// Is the stated error of a hand-eye calibration true? Hundreds of calibrations with everything that
// is not known drawn anew: cameras, spots, robot.
#include <cmath>
#include <vector>

#include <boost/math/distributions/chi_squared.hpp>
#include <gtest/gtest.h>

#include "tests/registration/hand_eye/drawn_spots.hpp"

namespace holdfast::registration {
namespace {

/// Share of the calibrations whose error at the working volume's middle lies in the predicted 95 %
/// region, and the mean of its squared sigmas (3 expected).
void expect_true_regions(bool has_beams) {
  constexpr std::uint32_t kRuns = 600;
  const double region = boost::math::quantile(boost::math::chi_squared{3}, 0.95);
  int inside = 0, found_count = 0;
  double squares = 0;
  for (std::uint32_t seed = 1; seed <= kRuns; ++seed) {
    test::DrawnSpots options;
    options.seed = seed;
    options.has_beams = has_beams;
    auto drawn = test::draw_hand_eye(options);
    drawn.input.limits.least_relief_mm = 0;    // of random heights some are flat, some spots close:
    drawn.input.limits.least_distance_mm = 0;  // no reason to leave them out here
    drawn.input.limits.largest_sigma_mm = 1;
    const HandEye found = find_hand_eye(drawn.input);
    if (found.status != HandEyeStatus::found) continue;
    ++found_count;
    const Eigen::Vector3d error = found.T_robot_camera * found.p_middle_camera_mm -
                                  drawn.T_robot_camera * found.p_middle_camera_mm;
    const double squared = error.dot(found.covariance_middle_mm2.ldlt().solve(error));
    squares += squared;
    inside += squared < region ? 1 : 0;
  }
  EXPECT_GE(found_count, 588);  // p < 0.001 in all, or in one of twelve: 2 of 1000
  const double share = static_cast<double>(inside) / found_count;
  ::testing::Test::RecordProperty("share_inside_percent", std::to_string(100 * share));
  ::testing::Test::RecordProperty("mean_squared_sigma", std::to_string(squares / found_count));
  EXPECT_GE(share, 0.93);
  EXPECT_LE(share, 0.97);
}

TEST(HandEyeCoverage, PointsLieInTheirPredictedRegion) {
  expect_true_regions(false);
}

TEST(HandEyeCoverage, BeamsLieInTheirPredictedRegion) {
  expect_true_regions(true);
}

}  // namespace
}  // namespace holdfast::registration
