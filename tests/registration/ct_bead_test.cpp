// SPDX-License-Identifier: Apache-2.0
// Bead centres against truth. The scanner here is made of numbers alone: a fine grid, blurred by
// discrete convolution, averaged into voxels; it shares nothing with the fit's closed form.
#include <cmath>
#include <numeric>
#include <random>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "registration/ct/bead_search.hpp"
#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

constexpr int kFine = 3;  // fine samples a voxel, each way
const Eigen::Vector3d voxel_mm(0.4, 0.4, 0.6);

struct Ball {
  Eigen::Vector3d p_mm;
  Eigen::Vector3d radii_mm;
  double hu;
};

struct Scene {
  std::array<int, 3> size = {18, 18, 12};
  std::vector<Ball> balls;
  Eigen::Vector3d side_normal = Eigen::Vector3d::UnitZ();
  double side_mm = 1e9;  // beyond normal . p = this is air
  double noise_hu = 12, blur_mm = 0.35, highest_hu = 3071;
};

void blur_axis(std::vector<double>& values, const std::array<int, 3>& n, int axis, double sigma) {
  const int reach = static_cast<int>(std::ceil(4 * sigma));
  std::vector<double> kernel;
  double sum = 0;
  for (int k = -reach; k <= reach; ++k) {
    kernel.push_back(std::exp(-0.5 * k * k / (sigma * sigma)));
    sum += kernel.back();
  }
  for (double& weight : kernel) weight /= sum;
  const int count = n[static_cast<std::size_t>(axis)];
  const int stride = axis == 0 ? 1 : axis == 1 ? n[0] : n[0] * n[1];
  std::vector<double> line(static_cast<std::size_t>(count + 2 * reach));
  for (int start = 0; start < static_cast<int>(values.size()); ++start) {
    if (start / stride % count != 0) continue;  // not the first of a line
    const auto at = [&](int here) -> double& {
      return values[static_cast<std::size_t>(start + std::clamp(here, 0, count - 1) * stride)];
    };
    for (int k = 0; k < count + 2 * reach; ++k) line[static_cast<std::size_t>(k)] = at(k - reach);
    for (int here = 0; here < count; ++here)
      at(here) = std::inner_product(kernel.begin(), kernel.end(), line.begin() + here, 0.0);
  }
}

CtVolume scan(const Scene& scene, unsigned seed) {
  const std::array<int, 3> n = {scene.size[0] * kFine, scene.size[1] * kFine,
                                scene.size[2] * kFine};
  const Eigen::Vector3d fine_mm = voxel_mm / kFine;
  std::vector<double> fine;
  for (int k = 0; k < n[2]; ++k)
    for (int j = 0; j < n[1]; ++j)
      for (int i = 0; i < n[0]; ++i) {
        const Eigen::Vector3d p =
            (Eigen::Vector3d(i, j, k) - Eigen::Vector3d::Ones() * (kFine - 1) / 2.0)
                .cwiseProduct(fine_mm);
        double hu = scene.side_normal.dot(p) > scene.side_mm ? -1000 : 120;
        for (const Ball& ball : scene.balls) {
          const Eigen::Vector3d d = p - ball.p_mm;
          const double inside = 1 - d.cwiseQuotient(ball.radii_mm).norm();
          // Partial volume of the fine sample itself: its edge is one sample wide.
          const double share =
              std::clamp(inside * ball.radii_mm.minCoeff() / fine_mm.x() + 0.5, 0.0, 1.0);
          hu += share * (ball.hu - hu);
        }
        fine.push_back(hu);
      }
  for (int axis = 0; axis < 3; ++axis) blur_axis(fine, n, axis, scene.blur_mm / fine_mm[axis]);
  std::mt19937 random(seed);
  std::normal_distribution<double> noise(0, scene.noise_hu);
  CtVolume volume;
  volume.size = scene.size;
  volume.column_step_mm *= voxel_mm.x();
  volume.row_step_mm *= voxel_mm.y();
  for (int k = 0; k < scene.size[2]; ++k) {
    volume.slice_origin_mm.emplace_back(0, 0, k * voxel_mm.z());
    for (int j = 0; j < scene.size[1]; ++j)
      for (int i = 0; i < scene.size[0]; ++i) {
        double sum = 0;
        for (int c = 0; c < kFine; ++c)
          for (int b = 0; b < kFine; ++b)
            for (int a = 0; a < kFine; ++a)
              sum += fine[static_cast<std::size_t>(((k * kFine + c) * n[1] + j * kFine + b) * n[0] +
                                                   i * kFine + a)];
        const double hu = sum / (kFine * kFine * kFine) + noise(random);
        volume.hu.push_back(
            static_cast<std::int16_t>(std::lround(std::clamp(hu, -1024.0, scene.highest_hu))));
      }
  }
  return volume;
}

Ball bead_at(const Eigen::Vector3d& p, double hu) {
  return {p, Eigen::Vector3d::Constant(0.75), hu};
}

Eigen::Vector3d somewhere(std::mt19937& random) {
  std::uniform_real_distribution<double> part(-0.5, 0.5);
  return Eigen::Vector3d(8.5 + part(random), 8.5 + part(random), 5.5 + part(random))
      .cwiseProduct(voxel_mm);
}

/// Over sub-voxel places, in plastic that ends 1 mm above the bead at any inclination.
double rms_over_places(double hu, bool has_side, double& worst_normalised) {
  std::mt19937 random(7);
  std::normal_distribution<double> normal;
  double sum = 0;
  int count = 0;
  worst_normalised = 0;
  for (unsigned seed = 0; seed < 5; ++seed) {
    Scene scene;
    const Eigen::Vector3d truth = somewhere(random);
    scene.balls = {bead_at(truth, hu)};
    if (has_side) {
      scene.side_normal =
          Eigen::Vector3d(normal(random), normal(random), normal(random)).normalized();
      scene.side_mm = scene.side_normal.dot(truth) + 1.0;
    }
    const BeadSearch search = find_beads(scan(scene, seed), 1.5);
    EXPECT_EQ(search.beads.size(), 1U) << seed;
    if (search.beads.size() != 1) {
      for (const auto& r : search.rejected) ADD_FAILURE() << r.reason;
      continue;
    }
    const Eigen::Vector3d error = search.beads[0].p_ct_mm - truth;
    sum += error.squaredNorm();
    ++count;
    worst_normalised =
        std::max(worst_normalised, error.dot(search.beads[0].covariance_mm2.inverse() * error));
  }
  return std::sqrt(sum / std::max(count, 1));
}

TEST(BeadSearch, CentresAreExactWhateverTheMetalAndTheHolder) {
  for (const double hu : {1500.0, 3000.0, 8000.0})
    for (const bool has_side : {false, true}) {
      double worst = 0;
      const double rms_mm = rms_over_places(hu, has_side, worst);
      RecordProperty("rms_um", static_cast<int>(1000 * rms_mm));
      std::printf("%.0f HU, side %d: rms %.4f mm, worst chi2(3) %.1f\n", hu, has_side, rms_mm,
                  worst);
      EXPECT_LE(rms_mm, 0.05) << hu << " HU, side " << has_side;
      EXPECT_LT(worst, 25) << "the covariance is too small";
    }
}

TEST(BeadSearch, WhatIsNoBeadIsRejectedWithItsReason) {
  std::mt19937 random(3);
  const Eigen::Vector3d middle = somewhere(random);
  struct Case {
    const char* name;
    Ball ball;
  };
  const std::vector<Case> cases = {
      {"wire", {middle, {0.3, 0.3, 4}, 8000}},
      {"filling", {middle, {1.6, 0.7, 0.6}, 8000}},
      {"crown", {middle, {2.2, 2.2, 2.2}, 8000}},
      {"faint", {middle, {0.75, 0.75, 0.75}, 450}},
  };
  for (const Case& c : cases) {
    Scene scene;
    scene.balls = {c.ball};
    const BeadSearch search = find_beads(scan(scene, 1), 1.5);
    EXPECT_TRUE(search.beads.empty()) << c.name;
    EXPECT_THROW((void)bead_points(search, std::nullopt), RefusedError);
  }
}

TEST(BeadSearch, CountsAndLabelsByPosition) {
  Scene scene;
  scene.size = {48, 24, 16};
  scene.balls = {bead_at({14, 4.7, 4.4}, 8000), bead_at({4.1, 4.3, 4.9}, 8000)};
  const BeadSearch search = find_beads(scan(scene, 1), 1.5);
  const auto points = bead_points(search, 2);
  ASSERT_EQ(points.size(), 2U);
  EXPECT_EQ(points[0].label, "bead-1");
  EXPECT_NEAR(points[0].position_mm.x(), 4.1, 0.05);
  EXPECT_NEAR(points[1].position_mm.x(), 14, 0.05);
  ASSERT_TRUE(points[0].covariance_mm2);
  EXPECT_NE(points[0].description.find("clipped"), std::string::npos);
  try {
    (void)bead_points(search, 4);
    FAIL() << "a missing bead went unnoticed";
  } catch (const RefusedError& e) {
    EXPECT_NE(std::string(e.what()).find("found 2 bead(s), expected 4"), std::string::npos);
  }
  EXPECT_THROW((void)find_beads(scan(scene, 1), 0.5), RefusedError);  // voxels of 0.6 mm
  EXPECT_THROW((void)find_beads(scan(scene, 1), 50), InputError);
}

}  // namespace
}  // namespace holdfast::registration
