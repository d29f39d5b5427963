// SPDX-License-Identifier: Apache-2.0
// The arithmetic of ties, and how a tied keyframe is made.
#include "perception/tie.hpp"

#include <cmath>
#include <random>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <gtest/gtest.h>

#include "perception/keyframe_maker.hpp"
#include "perception/tracker_parameters.hpp"
#include "tests/perception/support/moving_scene.hpp"

namespace holdfast::perception {
namespace {

using Vector6d = Eigen::Matrix<double, 6, 1>;
const Eigen::Vector3d kPivotFirst(0.1, -0.2, 200), kPivotTied(-0.3, 0.2, 203);

Matrix6d some_covariance(std::mt19937& random, double sigma_mm, double sigma_rad) {
  std::normal_distribution<double> normal;
  Matrix6d A;
  for (double& a : A.reshaped()) a = normal(random);
  A.topRows<3>() *= sigma_mm;
  A.bottomRows<3>() *= sigma_rad;
  return A * A.transpose();
}

/// The pose with an error as MotionEstimate::covariance has it.
Eigen::Isometry3d erring(const Eigen::Isometry3d& T, const Eigen::Vector3d& p_pivot,
                         const Vector6d& error) {
  const Eigen::Vector3d r = error.tail<3>();
  Eigen::Isometry3d out;
  out.linear() = Eigen::AngleAxisd(r.norm(), r.normalized()).toRotationMatrix() * T.linear();
  out.translation() = T * p_pivot + error.head<3>() - out.linear() * p_pivot;
  return out;
}

Vector6d error_between(const Eigen::Isometry3d& T, const Eigen::Isometry3d& T_wrong,
                       const Eigen::Vector3d& p_pivot) {
  const Eigen::AngleAxisd turn(T_wrong.linear() * T.linear().transpose());
  Vector6d error;
  error << T_wrong * p_pivot - T * p_pivot, turn.angle() * turn.axis();
  return error;
}

TEST(Tie, ErrorOfThePoseFollowsFromThoseOfItsTwoParts) {
  std::mt19937 random(5);
  const Eigen::Isometry3d T_tied = test::moved_about(kPivotFirst, {6, -3, 1}, {0.1, -0.05, 0.4});
  const Eigen::Isometry3d T_now = test::moved_about(kPivotTied, {-1, 2, 0.5}, {0.02, 0.1, -0.2});
  const Vector6d e_tie = 1e-3 * Vector6d(Vector6d::LinSpaced(-0.8, 1.2));
  const Vector6d e_now = 1e-3 * Vector6d(Vector6d::LinSpaced(0.9, -1.1));
  // One error at a time, its covariance e e^T: what comes out must be that of the whole pose's.
  for (const bool is_of_tie : {true, false}) {
    Tie tie{T_tied, Matrix6d::Zero()};
    CheckedPose now{T_now, Matrix6d::Zero()};
    (is_of_tie ? tie.covariance : now.covariance) =
        is_of_tie ? Matrix6d(e_tie * e_tie.transpose()) : Matrix6d(e_now * e_now.transpose());
    const CheckedPose through_tie = through(tie, now, kPivotTied, kPivotFirst);
    const Eigen::Isometry3d T_wrong = is_of_tie ? T_now * erring(T_tied, kPivotFirst, e_tie)
                                                : erring(T_now, kPivotTied, e_now) * T_tied;
    const Vector6d e = error_between(through_tie.T_camera_site, T_wrong, kPivotFirst);
    EXPECT_TRUE(through_tie.covariance.isApprox(e * e.transpose(), 0.01)) << is_of_tie;
  }
}

TEST(Tie, CovarianceHoldsForWhateverCorrelation) {
  RecordProperty("requirement", "SR-139");
  std::mt19937 random(6);
  for (int i = 0; i < 20; ++i) {
    const Matrix6d A = some_covariance(random, 0.003, 1e-4),
                   B = some_covariance(random, 0.001, 3e-4);
    const Matrix6d a = A.llt().matrixL(), b = B.llt().matrixL();
    for (const double correlation : {-1.0, 0.0, 1.0}) {
      const Matrix6d both = A + B + correlation * (a * b.transpose() + b * a.transpose());
      const Vector6d scale = both.diagonal().cwiseSqrt().cwiseInverse();
      const Matrix6d left = scale.asDiagonal() * (bound_of_sum(A, B) - both) * scale.asDiagonal();
      EXPECT_GT(Eigen::SelfAdjointEigenSolver<Matrix6d>(left).eigenvalues().minCoeff(), -1e-9);
    }
  }
  const Matrix6d alone = some_covariance(random, 1, 1);
  EXPECT_TRUE(bound_of_sum(alone, Matrix6d::Zero()).isApprox(alone));
}

TEST(Tie, TiedAnewSaysWhatBothPosesSay) {
  std::mt19937 random(7);
  const CheckedPose since_tied{test::moved_about(kPivotTied, {-1, 2, 0.5}, {0.02, 0.1, -0.2}),
                               some_covariance(random, 0.001, 1e-4)};
  const CheckedPose since_first{test::moved_about(kPivotFirst, {4, 2, 0.1}, {0.2, 0.1, 0.3}),
                                some_covariance(random, 0.002, 1e-4)};
  const Tie tie = tie_between(since_tied, since_first, kPivotTied, kPivotFirst);
  const CheckedPose again = through(tie, since_tied, kPivotTied, kPivotFirst);
  EXPECT_TRUE(again.T_camera_site.isApprox(since_first.T_camera_site, 1e-12));
  // What was added to make the tie is not taken away again.
  EXPECT_GT(again.covariance.trace(), since_first.covariance.trace());
  const PoseDifference none = between(again, since_first, kPivotFirst);
  EXPECT_NEAR(none.um, 0, 1e-6);
  EXPECT_NEAR(none.sigma, 0, 1e-6);
}

class MadeKeyframe : public ::testing::Test {
 protected:
  CameraModel camera_ = test::microscope_camera(512, 384);
  test::MovingScene scene_{camera_, test::photograph(), 200, 3};
  Eigen::Isometry3d T_ = test::moved_about(scene_.p_pivot_mm(), {-4, 1, 0.5}, {0.01, 0.02, 0.1});
};

TEST_F(MadeKeyframe, HasTheFirstOnesDepthAndNoneBeyond) {
  const Site site(camera_, SiteDepth{scene_.depth_mm()});
  const auto geometry = std::get<SiteDepth>(seen_from(camera_, site, T_));
  const Site seen(camera_, geometry);
  int known = 0, unknown = 0;
  for (double v = -150; v <= 150; v += 30)
    for (double u = -200; u <= 200; u += 20) {
      const Eigen::Vector2d ray(u / camera_.fx_px, v / camera_.fy_px);
      const auto p = seen.lift(ray);
      const auto p_site = site.meet(ray, T_);
      if (!p_site) {
        ++unknown;
        continue;
      }
      if (!p) continue;  // at the rim, where the coarser map ends a few pixels earlier
      ++known;
      EXPECT_NEAR(p->z(), (T_ * *p_site).z(), 0.005) << u << ' ' << v;
    }
  EXPECT_GT(known, 80);
  EXPECT_GT(unknown, 60) << "200 px of the view are beyond the first keyframe's image";
}

TEST_F(MadeKeyframe, OnAThreadIsTheOneMadeAtOnce) {
  TrackerParameters parameters;
  KeyframeMaker at_once(camera_, parameters, false), beside(camera_, parameters, true);
  const cv::Mat image = scene_.image(T_, 2, 3);
  const Site site(camera_, scene_.wide_depth(512));
  for (KeyframeMaker* maker : {&at_once, &beside}) {
    EXPECT_TRUE(maker->is_idle());
    EXPECT_FALSE(maker->take());
    KeyframeOrder order;
    order.image = image;
    order.site = site;
    order.tie.T_tied_first = T_;
    order.number = 3;
    maker->order(std::move(order));
    EXPECT_FALSE(maker->is_idle()) << "until it is taken";
  }
  beside.wait();
  const auto a = at_once.take(), b = beside.take();
  ASSERT_TRUE(a && a->keyframe && b && b->keyframe);
  EXPECT_EQ(b->keyframe->number, 3);
  ASSERT_EQ(a->keyframe->key.patches[0].size(), b->keyframe->key.patches[0].size());
  EXPECT_GT(a->keyframe->key.patches[0].size(), 300U);
  EXPECT_TRUE(a->keyframe->key.patches[0].geometry.back().p_site_mm.isApprox(
      b->keyframe->key.patches[0].geometry.back().p_site_mm));
  KeyframeOrder black;
  black.image = cv::Mat(384, 512, CV_8UC1, cv::Scalar(0));
  black.site = site;
  at_once.order(std::move(black));
  const auto none = at_once.take();
  ASSERT_TRUE(none);
  EXPECT_FALSE(none->keyframe);
  KeyframeOrder last;
  last.image = image;
  last.site = site;
  beside.order(std::move(last));  // and is ended with one in work
}

}  // namespace
}  // namespace holdfast::perception
