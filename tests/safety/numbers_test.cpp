// SPDX-License-Identifier: Apache-2.0
#include "safety/numbers.hpp"

#include <limits>

#include <gtest/gtest.h>

namespace holdfast::safety {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

TEST(IsRigid, AcceptsRotationsUpToRounding) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = Eigen::AngleAxisd(2, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  T.translation() << 1e6, -1e6, 3;
  EXPECT_TRUE(is_rigid(T));
  T.linear() *= 1 + 1e-7;
  EXPECT_TRUE(is_rigid(T));
}

TEST(IsRigid, RefusesScaleBeyondItsTolerance) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() *= 1 + 1e-6;  // 2e-6 in R^T·R
  EXPECT_FALSE(is_rigid(T));
  EXPECT_TRUE(is_rigid(T, 1e-5));
}

TEST(IsRigid, RefusesEveryElementBeingNan) {
  for (Eigen::Index i = 0; i < 16; ++i) {
    Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
    T.matrix()(i) = kNan;
    EXPECT_FALSE(is_rigid(T)) << i;
  }
}

TEST(IsCovariance, AcceptsNearlySingularOnes) {
  Matrix6d covariance = Matrix6d::Ones();  // rank one
  EXPECT_TRUE(is_covariance(covariance));
  covariance *= 1e-15;
  EXPECT_TRUE(is_covariance(covariance));
}

TEST(IsCovariance, JudgesMillimetresAndRadiansAlike) {
  Matrix6d covariance = Matrix6d::Identity();
  covariance.diagonal().tail<3>().setConstant(1e-10);
  covariance(3, 4) = covariance(4, 3) = 1.01e-10;  // a correlation above one
  EXPECT_FALSE(is_covariance(covariance));
}

TEST(IsCovariance, AllowsCorrelationsTheAsymmetryOfRoundingAndNoMore) {
  Matrix6d covariance = Matrix6d::Identity();
  covariance(0, 1) = 9e-10;
  EXPECT_TRUE(is_covariance(covariance));
  covariance(0, 1) = 1.1e-9;
  EXPECT_FALSE(is_covariance(covariance));
}

TEST(IsCovariance, RefusesEveryElementBeingNan) {
  for (Eigen::Index i = 0; i < 36; ++i) {
    Matrix6d covariance = Matrix6d::Identity();
    covariance(i) = kNan;
    EXPECT_FALSE(is_covariance(covariance)) << i;
  }
}

TEST(IsCovariance, RefusesAZeroVariance) {
  for (Eigen::Index i = 0; i < 6; ++i) {
    Matrix6d covariance = Matrix6d::Identity();
    covariance(i, i) = 0;
    EXPECT_FALSE(is_covariance(covariance)) << i;
  }
}

TEST(Comparisons, NeverPassNan) {
  EXPECT_TRUE(exceeds(kNan, 1));
  EXPECT_TRUE(exceeds(1, kNan));
  EXPECT_TRUE(falls_short(kNan, 1));
  EXPECT_TRUE(falls_short(1, kNan));
  EXPECT_FALSE(exceeds(1, 1));
  EXPECT_FALSE(falls_short(1, 1));
  EXPECT_FALSE(is_magnitude(kNan));
  EXPECT_FALSE(is_magnitude(std::numeric_limits<double>::infinity()));
  EXPECT_FALSE(is_magnitude(-1e-300));
  EXPECT_TRUE(is_magnitude(0));
}

TEST(Elapsed, HoldsAtTheEndsOfTheRange) {
  EXPECT_EQ(elapsed(Timestamp(3), Timestamp(5)), Duration(2));
  EXPECT_EQ(elapsed(Timestamp::min(), Timestamp(1)), Duration::max());
  EXPECT_EQ(elapsed(Timestamp::max(), Timestamp(-2)), Duration::min());
}

}  // namespace
}  // namespace holdfast::safety
