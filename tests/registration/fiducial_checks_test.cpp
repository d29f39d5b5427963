// SPDX-License-Identifier: Apache-2.0
#include "registration/fiducial_checks.hpp"

#include <algorithm>
#include <cmath>
#include <random>

#include <gtest/gtest.h>

namespace holdfast::registration {
namespace {

const Eigen::Isometry3d kTruth =
    Eigen::Translation3d{12, -30, 200} *
    Eigen::AngleAxisd{2.3, Eigen::Vector3d{0.2, -0.7, 0.4}.normalized()};

std::vector<Eigen::Vector3d> beads() {
  return {{-45, -25, 6}, {44, -22, 14}, {40, 26, 3}, {-38, 24, 10}};
}

std::vector<Eigen::Vector3d> moved(const std::vector<Eigen::Vector3d>& points) {
  std::vector<Eigen::Vector3d> result;
  for (const Eigen::Vector3d& p : points) result.push_back(kTruth * p);
  return result;
}

FiducialSet noisy_set(std::uint64_t seed, bool has_covariances) {
  std::mt19937_64 random{seed};
  std::normal_distribution<double> normal{0, 0.05};
  FiducialSet set;
  set.has_covariances = has_covariances;
  for (const Eigen::Vector3d& p : beads()) {
    FiducialPair pair;
    pair.label = "marker " + std::to_string(set.pairs.size());
    pair.p_ct_mm = p;
    pair.p_camera_mm = kTruth * p + Eigen::Vector3d{normal(random), normal(random), normal(random)};
    pair.covariance_camera_mm2 = 0.0025 * Eigen::Matrix3d::Identity();
    set.pairs.push_back(pair);
  }
  return set;
}

TEST(FindCorrespondence, FindsShuffledPointsAmongSurplusOnes) {
  std::vector<Eigen::Vector3d> fixed = beads();
  fixed.insert(fixed.begin() + 1, Eigen::Vector3d{5, 9, -20});  // a dental filling
  const std::vector<Eigen::Vector3d> moving =
      moved({beads()[2], beads()[0], beads()[3], beads()[1]});
  const Correspondence found = find_correspondence(fixed, moving, 0.5);
  ASSERT_EQ(found.status, CorrespondenceStatus::found);
  EXPECT_EQ(found.fixed_of_moving, (std::vector<std::size_t>{3, 0, 4, 2}));
  EXPECT_LT(found.fre_mm, 1e-9);
  EXPECT_GT(found.second_fre_mm, 0.5);
}

TEST(FindCorrespondence, RefusesASymmetricArrangement) {
  const std::vector<Eigen::Vector3d> square = {
      {-30, -30, 0}, {30, -30, 0}, {30, 30, 0}, {-30, 30, 0}};
  const Correspondence found = find_correspondence(square, moved(square), 0.5);
  EXPECT_EQ(found.status, CorrespondenceStatus::ambiguous);
  EXPECT_TRUE(found.fixed_of_moving.empty());
}

TEST(FindCorrespondence, FindsNothingInAnotherPatientOrAMirroredCt) {
  std::vector<Eigen::Vector3d> other = beads();
  for (Eigen::Vector3d& p : other) p.x() *= 1.1;
  EXPECT_EQ(find_correspondence(other, moved(beads()), 0.5).status, CorrespondenceStatus::none);
  std::vector<Eigen::Vector3d> mirrored = beads();
  for (Eigen::Vector3d& p : mirrored) p.x() = -p.x();
  EXPECT_EQ(find_correspondence(mirrored, moved(beads()), 0.5).status, CorrespondenceStatus::none);
}

TEST(FindCorrespondence, RefusesMoreThanItCanSearch) {
  const std::vector<Eigen::Vector3d> many(65, Eigen::Vector3d::Zero());
  EXPECT_EQ(find_correspondence(many, beads(), 0.5).status, CorrespondenceStatus::too_many);
  EXPECT_EQ(find_correspondence(beads(), {{0, 0, 0}}, 0.5).status, CorrespondenceStatus::none);
}

TEST(LeaveOneOut, NamesTheDisplacedMarkerAndHowFar) {
  RecordProperty("requirement", "SR-86");
  for (const bool has_covariances : {true, false})
    for (std::size_t displaced = 0; displaced < 4; ++displaced) {
      FiducialSet set = noisy_set(displaced + 1, has_covariances);
      // Within the markers' plane: across it two markers of four could share the blame.
      set.pairs[displaced].p_camera_mm += kTruth.linear() * Eigen::Vector3d{1, 0, 0};
      const std::vector<LeftOut> left_out = leave_one_out(set, fit_rigid(set));
      const auto worst = std::min_element(
          left_out.begin(), left_out.end(),
          [](const LeftOut& l, const LeftOut& r) { return l.p_value < r.p_value; });
      ASSERT_NE(worst, left_out.end());
      EXPECT_EQ(worst->label, set.pairs[displaced].label);
      EXPECT_NEAR(worst->displacement_mm, 1, 0.35);
      EXPECT_LT(worst->p_value, has_covariances ? 1e-6 : 0.05);
    }
}

TEST(LeaveOneOut, IsThePredictionFromTheOthersAlone) {
  const FiducialSet set = noisy_set(11, true);
  const std::vector<LeftOut> left_out = leave_one_out(set, fit_rigid(set));
  for (std::size_t i = 0; i < 4; ++i) {
    FiducialSet others = set;
    others.pairs.erase(others.pairs.begin() + static_cast<std::ptrdiff_t>(i));
    const Eigen::Vector3d predicted = fit_rigid(others).T_camera_ct * set.pairs[i].p_ct_mm;
    EXPECT_NEAR(left_out[i].displacement_mm, (set.pairs[i].p_camera_mm - predicted).norm(), 1e-3);
  }
}

TEST(LeaveOneOut, SeldomAccusesTrueMarkers) {
  int accused = 0;
  for (std::uint64_t seed = 0; seed < 2000; ++seed) {
    const FiducialSet set = noisy_set(seed, true);
    for (const LeftOut& l : leave_one_out(set, fit_rigid(set))) accused += l.p_value < 0.01 ? 1 : 0;
  }
  EXPECT_NEAR(accused / 8000.0, 0.01, 0.005);
}

TEST(LeaveOneOut, SaysNothingWithThreeMarkers) {
  FiducialSet set = noisy_set(1, true);
  set.pairs.pop_back();
  EXPECT_TRUE(leave_one_out(set, fit_rigid(set)).empty());
}

TEST(MirroredFre, IsSmallForAMirroredCtOnly) {
  FiducialSet set = noisy_set(1, true);
  EXPECT_GT(mirrored_fre_mm(set), 1);
  for (FiducialPair& pair : set.pairs) pair.p_ct_mm.y() = -pair.p_ct_mm.y();
  EXPECT_LT(mirrored_fre_mm(set), 0.2);
}

}  // namespace
}  // namespace holdfast::registration
