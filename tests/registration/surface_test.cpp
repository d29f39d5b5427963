// SPDX-License-Identifier: Apache-2.0
// Closest points, the evaluation of surfaces and their fusion with fiducials.
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <random>

#include <gtest/gtest.h>

#include "registration/evaluation.hpp"
#include "registration/surface_fit.hpp"
#include "registration/triangle_tree.hpp"

namespace holdfast::registration {
namespace {

/// A relief over x, y in +-half mm: z = height(x, y), triangles of about `step` mm.
double height_mm(double x, double y) {
  return 6 * std::sin(x / 9) * std::cos(y / 7) + 2 * std::sin((x + 2 * y) / 4) + 0.02 * x * y;
}

TriangleMesh relief(double half_x_mm, double half_y_mm, double step_mm) {
  TriangleMesh mesh;
  const auto nx = static_cast<std::uint32_t>(2 * half_x_mm / step_mm) + 1;
  const auto ny = static_cast<std::uint32_t>(2 * half_y_mm / step_mm) + 1;
  for (std::uint32_t j = 0; j < ny; ++j)
    for (std::uint32_t i = 0; i < nx; ++i) {
      const double x = -half_x_mm + i * step_mm, y = -half_y_mm + j * step_mm;
      mesh.vertices_mm.emplace_back(Eigen::Vector3d{x, y, height_mm(x, y)}.cast<float>());
      if (i + 1 == nx || j + 1 == ny) continue;
      const std::uint32_t a = j * nx + i;
      mesh.triangles.push_back({a, a + 1, a + nx + 1});
      mesh.triangles.push_back({a, a + nx + 1, a + nx});
    }
  return mesh;
}

Eigen::Vector3d random_point(std::mt19937_64& random, double half) {
  std::uniform_real_distribution<double> uniform{-half, half};
  return {uniform(random), uniform(random), uniform(random)};
}

TEST(TriangleTree, AgreesWithEveryTriangleTried) {
  std::mt19937_64 random{4};
  TriangleMesh soup;
  for (std::uint32_t t = 0; t < 300; ++t) {
    const Eigen::Vector3d centre = random_point(random, 20);
    for (int k = 0; k < 3; ++k)
      soup.vertices_mm.emplace_back((centre + random_point(random, 3)).cast<float>());
    soup.triangles.push_back({3 * t, 3 * t + 1, 3 * t + 2});
  }
  const TriangleTree tree{soup};
  for (int i = 0; i < 300; ++i) {
    const Eigen::Vector3d p = random_point(random, 30);
    double nearest = std::numeric_limits<double>::infinity();
    for (const auto& triangle : soup.triangles) {
      TriangleMesh one = soup;
      one.triangles = {triangle};
      nearest = std::min(nearest, TriangleTree{one}.closest(p).distance_mm);
    }
    const ClosestPoint closest = tree.closest(p);
    ASSERT_TRUE(closest.is_found);
    EXPECT_DOUBLE_EQ(closest.distance_mm, nearest);
    EXPECT_FALSE(tree.closest(p, nearest * 0.99).is_found);
  }
}

TEST(TriangleTree, DistancesToFaceEdgeAndCornerAreExact) {
  TriangleMesh mesh;
  mesh.vertices_mm = {{0, 0, 0}, {10, 0, 0}, {10, 10, 0}, {0, 10, 0}};
  mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
  const TriangleTree tree{mesh};
  EXPECT_DOUBLE_EQ(tree.closest({4, 2, 3}).distance_mm, 3);
  EXPECT_FALSE(tree.closest({4, 2, 3}).is_on_rim);
  EXPECT_FALSE(tree.closest({5, 5, 1}).is_on_rim) << "the diagonal has a triangle on either side";
  EXPECT_DOUBLE_EQ(tree.closest({5, -4, 3}).distance_mm, 5);
  EXPECT_TRUE(tree.closest({5, -4, 3}).is_on_rim);
  EXPECT_DOUBLE_EQ(tree.closest({-2, -1, 2}).distance_mm, 3);
  EXPECT_TRUE(tree.closest({-2, -1, 2}).is_on_rim);
  EXPECT_EQ(tree.normal(0), Eigen::Vector3d::UnitZ());
  EXPECT_FALSE(tree.closest({std::nan(""), 0, 0}).is_found);
}

TEST(TriangleTree, AnswersNothingWithoutArea) {
  TriangleMesh mesh;
  mesh.vertices_mm = {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}};
  EXPECT_FALSE(TriangleTree{mesh}.closest({0, 0, 0}).is_found);
  mesh.triangles = {{0, 1, 2}};
  EXPECT_FALSE(TriangleTree{mesh}.closest({0, 0, 0}).is_found);
}

TEST(DistanceFigures, AreThoseOfTheirDefinition) {
  const DistanceFigures f = distance_figures({4, 0, 1, 3, 2});
  EXPECT_DOUBLE_EQ(f.mean_mm, 2);
  EXPECT_DOUBLE_EQ(f.rmse_mm, std::sqrt(6));
  EXPECT_DOUBLE_EQ(f.sd_mm, std::sqrt(2.5));
  EXPECT_DOUBLE_EQ(f.median_mm, 2);
  EXPECT_DOUBLE_EQ(f.p90_mm, 3.6);
  EXPECT_DOUBLE_EQ(f.max_mm, 4);
  EXPECT_DOUBLE_EQ(f.share_over_1_mm, 0.6);
  EXPECT_TRUE(std::isnan(distance_figures({}).mean_mm));
}

TEST(EvaluateSurface, MeasuresAKnownOffsetInTheRegionOnly) {
  TriangleMesh reference;
  reference.vertices_mm = {{-50, -50, 0}, {50, -50, 0}, {50, 50, 0}, {-50, 50, 0}};
  reference.triangles = {{0, 1, 2}, {0, 2, 3}};
  TriangleMesh surface;
  for (int i = 0; i < 100; ++i)
    surface.vertices_mm.emplace_back(static_cast<float>(i % 10), static_cast<float>(i / 10),
                                     i % 10 < 5 ? 0.25F : 9.F);
  EvaluationOptions options;
  options.T_reference_surface = Eigen::Translation3d{0, 0, 0.25} * Eigen::Isometry3d::Identity();
  options.region_mm =
      Eigen::AlignedBox3d{Eigen::Vector3d{-0.5, -0.5, -1}, Eigen::Vector3d{4.5, 20, 1}};
  options.points = 20;
  const Evaluation evaluation = evaluate_surface(surface, reference, options);
  EXPECT_EQ(evaluation.points_in_region, 50U);
  EXPECT_EQ(evaluation.to_triangle.count, 20U);
  EXPECT_NEAR(evaluation.to_triangle.mean_mm, 0.5, 1e-6);
  EXPECT_GT(evaluation.to_vertex.mean_mm, 40) << "the nearest vertex is far";
  EXPECT_FALSE(heat_map(evaluation, 1).empty());
  options.seed = 2;
  EXPECT_NE(evaluate_surface(surface, reference, options).p_reference_mm,
            evaluation.p_reference_mm);
  options.region_mm =
      Eigen::AlignedBox3d{Eigen::Vector3d::Constant(500), Eigen::Vector3d::Constant(501)};
  EXPECT_EQ(evaluate_surface(surface, reference, options).to_triangle.count, 0U);
}

// --- fusion ---

const Eigen::Isometry3d kTruth =
    Eigen::Translation3d{3, -4, 200} *
    Eigen::AngleAxisd{3.0, Eigen::Vector3d{0.9, 0.1, 0.2}.normalized()};
constexpr double kFieldMm = 0.06, kNoiseMm = 0.05, kFiducialMm = 0.12;

/// A smooth random field over x, y, of unit variance and correlation length 10 mm.
class Field {
 public:
  explicit Field(std::mt19937_64& random) {
    std::normal_distribution<double> normal{0, 0.1};
    std::uniform_real_distribution<double> phase{0, 6.283185307};
    for (Wave& wave : waves_) wave = {normal(random), normal(random), phase(random)};
  }
  [[nodiscard]] double at(double x, double y) const {
    double sum = 0;
    for (const Wave& wave : waves_) sum += std::cos(wave.kx * x + wave.ky * y + wave.phase);
    return sum * std::sqrt(2.0 / static_cast<double>(waves_.size()));
  }

 private:
  struct Wave {
    double kx, ky, phase;
  };
  std::array<Wave, 60> waves_{};
};

/// Points of the relief in the camera, with noise and a smooth error.
std::vector<Eigen::Vector3d> reconstruction(std::mt19937_64& random) {
  std::uniform_real_distribution<double> uniform{-1, 1};
  std::normal_distribution<double> normal;
  const Field field{random};
  std::vector<Eigen::Vector3d> points;
  for (int i = 0; i < 3000; ++i) {
    const double x = 33 * uniform(random), y = 22 * uniform(random);
    const double error = kFieldMm * field.at(x, y) + kNoiseMm * normal(random);
    points.push_back(kTruth * Eigen::Vector3d{x, y, height_mm(x, y) + error});
  }
  return points;
}

FiducialSet fiducial_set(std::mt19937_64& random, double sigma_mm) {
  std::normal_distribution<double> normal{0, sigma_mm};
  FiducialSet set;
  set.has_covariances = true;
  for (const Eigen::Vector3d& p : {Eigen::Vector3d{-45, -25, 6}, Eigen::Vector3d{44, -22, 14},
                                   Eigen::Vector3d{40, 26, 3}, Eigen::Vector3d{-38, 24, 10}}) {
    const Eigen::Vector3d error{normal(random), normal(random), normal(random)};
    set.pairs.push_back({"", p, kTruth * p + error, Eigen::Matrix3d::Zero(),
                         sigma_mm * sigma_mm * Eigen::Matrix3d::Identity()});
  }
  return set;
}

RigidFit fiducial_fit(std::mt19937_64& random) {
  return fit_rigid(fiducial_set(random, kFiducialMm));
}

bool region_contains_truth(const SurfaceFit& fit) {
  const Eigen::Vector3d target{5, -6, -12};
  const Eigen::Vector3d error = fit.T_camera_ct * target - kTruth * target;
  const Eigen::Matrix3d covariance = target_covariance(fit.T_camera_ct, fit.covariance, target);
  return error.dot(covariance.ldlt().solve(error)) <= 7.814728;
}

double target_error_mm(const Eigen::Isometry3d& T) {
  const Eigen::Vector3d target{5, -6, -12};
  return (T * target - kTruth * target).norm();
}

class FuseSurface : public testing::Test {
 public:
  static const TriangleTree& ct() {
    static const TriangleTree tree{relief(45, 32, 0.5)};
    return tree;
  }
};

TEST_F(FuseSurface, HelpsAPoorRegistrationAndKeepsItsRegionTrue) {
  RecordProperty("requirement", "SR-87");
  constexpr int kRuns = 60;
  std::mt19937_64 random{21};
  double before = 0, after = 0;
  int contained = 0;
  for (int i = 0; i < kRuns; ++i) {
    const RigidFit start = fiducial_fit(random);
    const SurfaceFit fit = fuse_surface(start, reconstruction(random), ct(), {});
    ASSERT_EQ(fit.status, SurfaceFitStatus::fused) << "p " << fit.p_value;
    before += std::pow(target_error_mm(start.T_camera_ct), 2);
    after += std::pow(target_error_mm(fit.T_camera_ct), 2);
    contained += region_contains_truth(fit) ? 1 : 0;
  }
  EXPECT_LT(after, 0.7 * before);
  EXPECT_GE(contained, 52) << "of 60; 57 expected";
}

/// The calibration has moved fiducials and surface by the same vector, which no fit of them to the
/// CT can tell.
TEST_F(FuseSurface, DoesNotClaimToKnowWhatTheCalibrationMovesAsAWhole) {
  RecordProperty("requirement", "SR-123");
  constexpr int kRuns = 20;
  const Eigen::Vector3d common_sigma_mm{0.03, 0.03, 0.12};
  std::mt19937_64 random{26};
  std::normal_distribution<double> normal;
  int contained = 0;
  for (int i = 0; i < kRuns; ++i) {
    const Eigen::Vector3d common = common_sigma_mm.cwiseProduct(
        Eigen::Vector3d{normal(random), normal(random), normal(random)});
    FiducialSet set = fiducial_set(random, 0.02);
    set.joint_covariance_camera_mm2 = 4e-4 * Eigen::MatrixXd::Identity(12, 12);
    for (Eigen::Index j = 0; j < 4; ++j) {
      set.pairs[static_cast<std::size_t>(j)].p_camera_mm += common;
      for (Eigen::Index k = 0; k < 4; ++k)
        set.joint_covariance_camera_mm2.block<3, 3>(3 * j, 3 * k) +=
            common_sigma_mm.cwiseAbs2().asDiagonal();
    }
    std::vector<Eigen::Vector3d> surface = reconstruction(random);
    for (Eigen::Vector3d& p : surface) p += common;
    const SurfaceFit fit = fuse_surface(fit_rigid(set), surface, ct(), {});
    ASSERT_EQ(fit.status, SurfaceFitStatus::fused) << "p " << fit.p_value;
    contained += region_contains_truth(fit) ? 1 : 0;
  }
  EXPECT_GE(contained, 16) << "of 20; 19 expected";
}

TEST_F(FuseSurface, FindsTheSurfaceFromAMillimetreAway) {
  std::mt19937_64 random{25};
  RigidFit vague;
  vague.status = FitStatus::fitted;
  // A millimetre aside and two degrees turned, about the relief's middle: more than one step mends.
  vague.T_camera_ct = Eigen::Translation3d{0.8, -0.6, 0.3} * kTruth *
                      Eigen::AngleAxisd{0.035, Eigen::Vector3d{0.3, 0.2, 0.9}.normalized()};
  vague.covariance = (Vector6d{} << 1, 1, 1, 1e-3, 1e-3, 1e-3).finished().asDiagonal();
  const SurfaceFit fit = fuse_surface(vague, reconstruction(random), ct(), {});
  ASSERT_EQ(fit.status, SurfaceFitStatus::fused);
  EXPECT_LT(target_error_mm(fit.T_camera_ct), 0.05);
}

TEST_F(FuseSurface, DoesNotHarmAGoodRegistration) {
  RecordProperty("requirement", "SR-87");
  std::mt19937_64 random{22};
  double after = 0;
  constexpr int kRuns = 20;
  for (int i = 0; i < kRuns; ++i) {
    RigidFit good;
    good.status = FitStatus::fitted;
    good.T_camera_ct = kTruth;
    good.covariance = (Vector6d{} << 1e-4, 1e-4, 1e-4, 1e-8, 1e-8, 1e-8).finished().asDiagonal();
    const SurfaceFit fit = fuse_surface(good, reconstruction(random), ct(), {});
    ASSERT_EQ(fit.status, SurfaceFitStatus::fused);
    after += std::pow(target_error_mm(fit.T_camera_ct), 2);
  }
  EXPECT_LT(std::sqrt(after / kRuns), 0.02);
}

/// Single points off to one side, a patch of their own each: what a matcher leaves at depth edges.
TEST_F(FuseSurface, IsNotPulledByRaggedEnds) {
  RecordProperty("requirement", "SR-87");
  std::mt19937_64 random{27};
  const RigidFit start = fiducial_fit(random);
  std::vector<Eigen::Vector3d> surface = reconstruction(random);
  const SurfaceFit clean = fuse_surface(start, surface, ct(), {});
  for (double x = -43; x < 44; x += 4.3)
    for (const double y : {-30.0, -26.0, 26.0, 30.0})
      surface.push_back(kTruth * Eigen::Vector3d{x, y, height_mm(x, y) + 0.15});
  const SurfaceFit ragged = fuse_surface(start, surface, ct(), {});
  ASSERT_EQ(ragged.status, SurfaceFitStatus::fused);
  const Eigen::Vector3d site{0, 0, height_mm(0, 0)};
  EXPECT_LT((ragged.T_camera_ct * site - clean.T_camera_ct * site).norm(), 0.012);
}

TEST_F(FuseSurface, RefusesASurfaceThatContradictsTheFiducials) {
  RecordProperty("requirement", "SR-87");
  std::mt19937_64 random{23};
  RigidFit start = fiducial_fit(random);
  start.T_camera_ct.translation() += Eigen::Vector3d{0.2, 0, 1.2};
  EXPECT_EQ(fuse_surface(start, reconstruction(random), ct(), {}).status,
            SurfaceFitStatus::disagreement);
}

TEST_F(FuseSurface, RefusesASurfaceOfSomethingElse) {
  std::mt19937_64 random{24};
  const RigidFit start = fiducial_fit(random);
  std::vector<Eigen::Vector3d> elsewhere = reconstruction(random);
  for (Eigen::Vector3d& p : elsewhere) p.z() += 30;
  EXPECT_EQ(fuse_surface(start, elsewhere, ct(), {}).status, SurfaceFitStatus::no_overlap);
  EXPECT_EQ(fuse_surface(start, {}, ct(), {}).status, SurfaceFitStatus::no_overlap);
}

}  // namespace
}  // namespace holdfast::registration
