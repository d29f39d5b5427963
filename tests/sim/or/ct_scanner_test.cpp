// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/ct_scanner.hpp"

#include <algorithm>

#include <gtest/gtest.h>

#include "rt/core/error.hpp"

namespace holdfast::sim {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3f;

// A bead of titanium in a block of plastic that fills the scan.
Phantom bead_phantom(const Vector3d& p_bead) {
  Phantom phantom;
  phantom.scan_box_mm = {p_bead - Vector3d::Constant(4), p_bead + Vector3d::Constant(4)};
  phantom.hounsfield = [p_bead](const Vector3f& p) {
    const float d = (p - p_bead.cast<float>()).norm() - 0.75F;
    return 150.F + 7850.F * std::clamp(0.5F - d / 0.1F, 0.F, 1.F);
  };
  return phantom;
}

Vector3d centroid(const CtVolume& volume, double floor_hu) {
  Vector3d sum = Vector3d::Zero();
  double weights = 0;
  for (std::size_t k = 0; k < volume.slices.size(); ++k)
    for (int row = 0; row < volume.slices[k].rows; ++row)
      for (int column = 0; column < volume.slices[k].cols; ++column) {
        const double weight = std::max(0.0, volume.slices[k](row, column) - floor_hu);
        sum += weight * volume.position(column, row, static_cast<double>(k));
        weights += weight;
      }
  return sum / weights;
}

TEST(CtScanner, SeesABeadWhereItIs) {
  const Vector3d p_bead{12.34, -56.78, 90.12};
  for (const double tilt : {0.0, 12.0})
    for (const std::uint32_t seed : {1U, 2U}) {
      CtScannerParameters parameters;
      parameters.seed = seed;
      parameters.oblique_deg = 10;
      parameters.gantry_tilt_deg = tilt;
      const CtVolume volume = scan(bead_phantom(p_bead), parameters);
      EXPECT_LT((centroid(volume, 600) - p_bead).norm(), 0.05) << "seed " << seed;
    }
}

TEST(CtScanner, SaturatesInMetalAndNoisesPlastic) {
  CtScannerParameters parameters;
  parameters.noise_hu = 12;
  const CtVolume volume = scan(bead_phantom({0, 0, 0}), parameters);
  double highest = 0;
  for (const auto& slice : volume.slices) {
    double slice_highest = 0;
    cv::minMaxLoc(slice, nullptr, &slice_highest);
    highest = std::max(highest, slice_highest);
  }
  EXPECT_EQ(highest, 3071);
  cv::Scalar mean, deviation;
  cv::meanStdDev(volume.slices.front(), mean, deviation);
  EXPECT_NEAR(mean[0], 150, 5);
  EXPECT_NEAR(deviation[0], 12, 2);
}

TEST(CtScanner, RepeatsWithTheSeedOnly) {
  CtScannerParameters parameters;
  const Phantom phantom = bead_phantom({0, 0, 0});
  const CtVolume one = scan(phantom, parameters);
  const CtVolume again = scan(phantom, parameters);
  parameters.seed = 2;
  const CtVolume other = scan(phantom, parameters);
  ASSERT_EQ(one.slices.size(), again.slices.size());
  for (std::size_t k = 0; k < one.slices.size(); ++k)
    EXPECT_EQ(cv::norm(one.slices[k], again.slices[k], cv::NORM_INF), 0);
  EXPECT_NE(one.origin_mm, other.origin_mm);
}

TEST(CtScanner, RefusesParametersOutOfRange) {
  CtScannerParameters parameters;
  parameters.slice_mm = 0;
  EXPECT_THROW((void)scan(bead_phantom({0, 0, 0}), parameters), InputError);
}

}  // namespace
}  // namespace holdfast::sim
