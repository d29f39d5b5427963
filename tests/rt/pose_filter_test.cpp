// SPDX-License-Identifier: Apache-2.0
#include "rt/pose_filter.hpp"

#include <cmath>
#include <functional>
#include <limits>
#include <numbers>
#include <random>
#include <vector>

#include <Eigen/Eigenvalues>
#include <gtest/gtest.h>

#include "tests/rt/virtual_inputs.hpp"

namespace holdfast::rt {
namespace {

using Correction = PoseFilter::Correction;
using Eigen::Isometry3d;
using Eigen::Matrix3d;
using Eigen::Vector3d;
using perception::Matrix6d;
using perception::MotionEstimate;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using testing::diagonal_covariance;
using Vector6d = Eigen::Matrix<double, 6, 1>;

constexpr nanoseconds kFramePeriod = testing::kFramePeriod;
const Vector3d kPivot(0, 0, 200);

Matrix3d turn(const Vector3d& r) {
  return r.norm() == 0 ? Matrix3d::Identity()
                       : Eigen::AngleAxisd(r.norm(), r.normalized()).toRotationMatrix();
}

/// The site with its pivot moved by `t` and turned by R about it.
Isometry3d moved(const Vector3d& t, const Matrix3d& R = Matrix3d::Identity()) {
  Isometry3d T_camera_site = Isometry3d::Identity();
  T_camera_site.linear() = R;
  T_camera_site.translation() = kPivot + t - R * kPivot;
  return T_camera_site;
}

MotionEstimate estimate_of(nanoseconds t, const Isometry3d& T_camera_site,
                           const Matrix6d& covariance = diagonal_covariance(0.01, 1e-4)) {
  MotionEstimate estimate;
  estimate.status = perception::TrackingStatus::tracking;
  estimate.t_exposure = t;
  estimate.T_camera_site = T_camera_site;
  estimate.p_pivot_site_mm = kPivot;
  estimate.covariance = covariance;
  return estimate;
}

double seconds(nanoseconds t) {
  return std::chrono::duration<double>(t).count();
}

/// Error of the pivot's position and of the rotation, as the covariance has them.
Vector6d error_of(const Isometry3d& T, const Isometry3d& T_true) {
  const Eigen::AngleAxisd r(T_true.linear() * T.linear().transpose());
  Vector6d error;
  error << T_true * kPivot - T * kPivot, r.angle() * r.axis();
  return error;
}

double normalised_error_squared(const safety::PredictedPose& pose, const Isometry3d& T_true) {
  const Vector6d error = error_of(pose.T_camera_site, T_true);
  return error.dot(pose.covariance.ldlt().solve(error));
}

class Noise {
 public:
  explicit Noise(unsigned seed) : engine_(seed) {}
  Vector3d operator()(double sigma) {
    Vector3d v;
    for (int i = 0; i < 3; ++i) v(i) = sigma * normal_(engine_);
    return v;
  }
  MotionEstimate measure(nanoseconds t, const Isometry3d& T_true) {
    const Isometry3d noise_free = T_true;
    Isometry3d T = noise_free;
    T.linear() = turn((*this)(1e-4)) * noise_free.linear();
    T.translation() = noise_free * kPivot + (*this)(0.01) - T.linear() * kPivot;
    return estimate_of(t, T);
  }

 private:
  std::mt19937 engine_;
  std::normal_distribution<double> normal_;
};

/// Paper B's robot: straight lines between the waypoints at 2 mm/s, image plane.
Vector3d along(const std::vector<Vector3d>& waypoints, double time_s) {
  double left_mm = 2.0 * time_s;
  for (std::size_t i = 1; i < waypoints.size(); ++i) {
    const Vector3d leg = waypoints[i] - waypoints[i - 1];
    if (left_mm < leg.norm()) return waypoints[i - 1] + left_mm * leg.normalized();
    left_mm -= leg.norm();
  }
  return waypoints.back();
}

/// Equation (4).
std::vector<Vector3d> linear_waypoints() {
  return {{0, 0, 0}, {0, 10, 0}, {0, -10, 0}, {10, 0, 0}, {-10, 0, 0}, {0, 0, 0}};
}

/// Equation (5).
std::vector<Vector3d> spiral_waypoints() {
  std::vector<Vector3d> waypoints;
  for (int n = 0; n <= 25; ++n) {
    const double a = 4 * 2 * std::numbers::pi * n / 50.0;
    waypoints.emplace_back(10 * n / 50.0 * std::sin(a), 10 * n / 50.0 * std::cos(a), 0);
  }
  return waypoints;
}

/// Follows the waypoints with noisy estimates and looks 5 to 80 ms ahead of each.
void expect_honest(const std::vector<Vector3d>& waypoints, int frames) {
  constexpr double kChi2Of6At99Percent = 16.81;
  const PoseFilterParameters parameters;
  PoseFilter filter;
  Noise noise(1);
  int looks = 0;
  int outside = 0;
  double worst_mm = 0;
  for (int frame = 0; frame < frames; ++frame) {
    const nanoseconds t = frame * kFramePeriod;
    const Correction correction =
        filter.correct(noise.measure(t, moved(along(waypoints, seconds(t)))), parameters);
    ASSERT_EQ(correction, frame == 0 ? Correction::started : Correction::corrected) << frame;
    for (int ahead_ms = 5; ahead_ms <= 80; ahead_ms += 15) {
      const nanoseconds now = t + milliseconds(ahead_ms);
      const auto pose = filter.predict(now, parameters);
      ASSERT_TRUE(pose);
      const Isometry3d T_true = moved(along(waypoints, seconds(now)));
      ++looks;
      if (normalised_error_squared(*pose, T_true) > kChi2Of6At99Percent) ++outside;
      worst_mm = std::max(worst_mm, error_of(pose->T_camera_site, T_true).head<3>().norm());
    }
  }
  EXPECT_LE(outside, looks / 100) << "of " << looks << ", worst " << worst_mm << " mm";
}

TEST(PoseFilter, IsHonestOnPaperBsLinearTrajectory) {
  expect_honest(linear_waypoints(), 1300);
}
TEST(PoseFilter, IsHonestOnPaperBsSpiral) {
  expect_honest(spiral_waypoints(), 900);
}

// On motion that is exactly its model the normalised error squared averages 6: neither too sure nor
// too unsure. 3000 steps leave a standard deviation of the mean of 0.06 if they were independent.
TEST(PoseFilter, CovarianceMatchesTheErrorOnItsOwnModel) {
  const PoseFilterParameters parameters;
  PoseFilter filter;
  Noise noise(2);
  const double dt = seconds(kFramePeriod);
  Vector3d p = Vector3d::Zero();
  Vector3d v = Vector3d::Zero();
  Vector3d w = Vector3d::Zero();
  Matrix3d R = Matrix3d::Identity();
  double sum = 0;
  constexpr int kSteps = 3000;
  for (int step = 0; step < kSteps + 10; ++step) {
    const nanoseconds t = step * kFramePeriod;
    ASSERT_NE(filter.correct(noise.measure(t, moved(p, R)), parameters),
              Correction::invalid_number);
    // Over dt: dv of variance density*dt, and a position change dv*dt/2 plus an independent part
    // of variance density*dt^3/12.
    const double a = std::sqrt(parameters.acceleration_density_mm2_per_s3 * dt);
    const double b = std::sqrt(parameters.angular_acceleration_density_rad2_per_s3 * dt);
    const Vector3d dv = noise(a), dw = noise(b);
    const Vector3d dp = dv * dt / 2 + noise(a * dt / std::sqrt(12.0));
    const Vector3d dr = dw * dt / 2 + noise(b * dt / std::sqrt(12.0));
    p += v * dt + dp;
    R = turn(w * dt + dr) * R;
    v += dv;
    w += dw;
    const auto pose = filter.predict(t + kFramePeriod, parameters);
    ASSERT_TRUE(pose);
    if (step >= 10) sum += normalised_error_squared(*pose, moved(p, R));
  }
  EXPECT_NEAR(sum / kSteps, 6.0, 0.4);
}

// After a bump the filter holds a velocity that is plainly wrong. With estimates good to a tenth of
// a micrometre it must forget it, not turn it round at every frame.
TEST(PoseFilter, ForgetsAWrongVelocityWithinAFewFrames) {
  const PoseFilterParameters parameters;
  PoseFilter filter;
  const auto exact = [](nanoseconds t, double x_mm) {
    MotionEstimate estimate = estimate_of(t, moved(Vector3d(x_mm, 0, 0)));
    estimate.covariance.diagonal() << 1e-8, 1e-8, 1e-6, 2.5e-5, 2.5e-5, 1e-12;
    return estimate;
  };
  nanoseconds t{};
  for (int frame = 0; frame < 30; ++frame, t += kFramePeriod)  // 4 mm/s, then at rest
    filter.correct(exact(t, 4 * seconds(t)), parameters);
  const double x_mm = 4 * seconds(t);
  for (int frame = 0; frame < 12; ++frame, t += kFramePeriod)
    ASSERT_NE(filter.correct(exact(t, x_mm), parameters), Correction::contradicts) << frame;
  const auto pose = filter.predict(filter.t_newest() + kFramePeriod, parameters);
  ASSERT_TRUE(pose);
  EXPECT_LT(pose->speed_mm_per_s, 1e-3);
  EXPECT_LT(error_of(pose->T_camera_site, moved(Vector3d(x_mm, 0, 0))).head<3>().norm(), 1e-4);
}

TEST(PoseFilter, PredictsConstantVelocityAhead) {
  const PoseFilterParameters parameters;
  PoseFilter filter;
  const Vector3d v(2, -1, 0.5);
  const Vector3d w(0.01, 0.02, -0.03);
  const auto truth = [&](nanoseconds t) { return moved(v * seconds(t), turn(w * seconds(t))); };
  nanoseconds t{};
  for (int frame = 0; frame < 60; ++frame, t = frame * kFramePeriod) {
    filter.correct(estimate_of(t, truth(t)), parameters);
  }
  const nanoseconds now = filter.t_newest() + milliseconds(80);
  const auto pose = filter.predict(now, parameters);
  ASSERT_TRUE(pose);
  const Vector6d error = error_of(pose->T_camera_site, truth(now));
  EXPECT_LT(error.head<3>().norm(), 1e-4);
  EXPECT_LT(error.tail<3>().norm(), 1e-5);
  EXPECT_NEAR(pose->speed_mm_per_s, v.norm(), 1e-3);
}

TEST(PoseFilter, CovarianceGrowsWithTime) {
  RecordProperty("requirement", "SR-66");
  const PoseFilterParameters parameters;
  PoseFilter filter;
  for (int frame = 0; frame < 10; ++frame) {
    filter.correct(estimate_of(frame * kFramePeriod, moved(Vector3d::Zero())), parameters);
  }
  Vector6d previous = Vector6d::Zero();
  for (int ms = 1; ms <= 300; ms += 10) {
    const auto pose = filter.predict(filter.t_newest() + milliseconds(ms), parameters);
    ASSERT_TRUE(pose);
    const Vector6d variance = pose->covariance.diagonal();
    // Never below the estimate's own (1e-4 mm², 1e-8 rad²), and strictly growing above it.
    EXPECT_TRUE((variance.array() >= (1 - 1e-9) * previous.array()).all()) << ms;
    EXPECT_GE(variance(0), (1 - 1e-9) * 1e-4);
    EXPECT_GE(variance(5), (1 - 1e-9) * 1e-8);
    previous = variance;
  }
  EXPECT_GT(std::sqrt(previous(0)), 1.1);  // sqrt(150 · 0.29³ / 3) mm
}

TEST(PoseFilter, AveragingNeverClaimsMoreThanTheNewestEstimate) {
  // A planar estimate does not know the tilt; hundreds of them do not know it better.
  const PoseFilterParameters parameters;
  Matrix6d planar = diagonal_covariance(0.01, 1e-4);
  planar(3, 3) = planar(4, 4) = 0.2 * 0.2;
  PoseFilter filter;
  for (int frame = 0; frame < 600; ++frame) {
    filter.correct(estimate_of(frame * kFramePeriod, moved(Vector3d::Zero()), planar), parameters);
  }
  const auto pose = filter.predict(filter.t_newest(), parameters);
  ASSERT_TRUE(pose);
  const Matrix6d surplus = pose->covariance - (1 - 1e-9) * planar;
  EXPECT_GE(surplus.selfadjointView<Eigen::Lower>().eigenvalues().minCoeff(), -1e-12);
}

class RunningFilter : public ::testing::Test {
 public:
  void SetUp() override {
    for (; frame < 30; ++frame) correct(moved(Vector3d::Zero()));
    --frame;
  }
  Correction correct(const Isometry3d& T) {
    return filter.correct(estimate_of(frame * kFramePeriod, T), parameters);
  }
  PoseFilterParameters parameters;
  PoseFilter filter;
  int frame = 0;
};

TEST_F(RunningFilter, AJumpContradictsAndLeavesTheStateAlone) {
  const auto before = filter.predict(filter.t_newest() + milliseconds(50), parameters);
  ++frame;
  EXPECT_EQ(correct(moved(Vector3d(0.5, 0, 0))), Correction::contradicts);
  EXPECT_EQ(correct(moved(Vector3d::Zero(), turn(Vector3d(0, 0, 0.02)))), Correction::contradicts);
  const auto after = filter.predict(filter.t_newest() + milliseconds(50), parameters);
  ASSERT_TRUE(before && after);
  EXPECT_EQ(before->T_camera_site.matrix(), after->T_camera_site.matrix());
  EXPECT_EQ(before->covariance, after->covariance);
  EXPECT_EQ(correct(moved(Vector3d::Zero())), Correction::corrected);
}

TEST_F(RunningFilter, StartsAnewAfterContradictionsForTheWholeGap) {
  const Isometry3d elsewhere = moved(Vector3d(10, 0, 0));
  const nanoseconds accepted = filter.t_newest();
  for (++frame; frame * kFramePeriod - accepted <= milliseconds(150); ++frame) {
    ASSERT_EQ(correct(elsewhere), Correction::contradicts);
  }
  while (frame * kFramePeriod - accepted <= parameters.gap_max) ++frame;
  EXPECT_EQ(correct(elsewhere), Correction::started);
  ++frame;
  EXPECT_EQ(correct(elsewhere), Correction::corrected);
}

TEST_F(RunningFilter, StartsAnewAfterAGapWithItsInitialUncertainty) {
  frame += 10;
  EXPECT_EQ(correct(moved(Vector3d(5, 0, 0))), Correction::started);
  const auto pose = filter.predict(filter.t_newest() + milliseconds(100), parameters);
  ASSERT_TRUE(pose);
  EXPECT_GE(std::sqrt(pose->covariance(0, 0)), 0.1 * parameters.velocity_sigma_init_mm_per_s);
}

TEST_F(RunningFilter, RefusesWhatIsNotNewer) {
  EXPECT_EQ(correct(moved(Vector3d::Zero())), Correction::not_newer);
  --frame;
  EXPECT_EQ(correct(moved(Vector3d::Zero())), Correction::not_newer);
}

TEST_F(RunningFilter, RefusesInvalidNumbersAndLeavesTheStateAlone) {
  ++frame;
  const auto refuses = [&](auto spoil) {
    MotionEstimate estimate = estimate_of(frame * kFramePeriod, moved(Vector3d::Zero()));
    spoil(estimate);
    EXPECT_EQ(filter.correct(estimate, parameters), Correction::invalid_number);
  };
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double infinity = std::numeric_limits<double>::infinity();
  refuses([&](auto& e) { e.T_camera_site.translation().z() = nan; });
  refuses([&](auto& e) { e.T_camera_site.linear()(1, 2) = infinity; });
  refuses([&](auto& e) { e.T_camera_site.linear() *= 1.01; });
  refuses([&](auto& e) { e.T_camera_site.linear().col(0) *= -1; });
  refuses([&](auto& e) { e.p_pivot_site_mm.x() = nan; });
  refuses([&](auto& e) { e.covariance(0, 0) = nan; });
  refuses([&](auto& e) { e.covariance.setZero(); });
  refuses([&](auto& e) { e.covariance(0, 1) = 1; });
  refuses([&](auto& e) { e.covariance(0, 0) *= -1; });
  EXPECT_EQ(correct(moved(Vector3d::Zero())), Correction::corrected);
}

TEST_F(RunningFilter, PredictsOnlyWithinItsBounds) {
  const nanoseconds t = filter.t_newest();
  EXPECT_FALSE(PoseFilter().predict(t, parameters));
  EXPECT_FALSE(filter.predict(t - nanoseconds(1), parameters));
  EXPECT_TRUE(filter.predict(t, parameters));
  EXPECT_TRUE(filter.predict(t + parameters.gap_max, parameters));
  EXPECT_FALSE(filter.predict(t + parameters.gap_max + nanoseconds(1), parameters));
  filter.reset();
  EXPECT_FALSE(filter.predict(t, parameters));
}

/// The same knowledge about another pivot: an estimate whose covariance is carried over to it.
MotionEstimate about(const MotionEstimate& estimate, const Vector3d& p_pivot_site_mm) {
  const Vector3d d = estimate.T_camera_site.linear() * (p_pivot_site_mm - estimate.p_pivot_site_mm);
  Matrix6d J = Matrix6d::Identity();
  J.topRightCorner<3, 3>() << 0, d.z(), -d.y(), -d.z(), 0, d.x(), d.y(), -d.x(), 0;
  MotionEstimate other = estimate;
  other.p_pivot_site_mm = p_pivot_site_mm;
  other.covariance = J * estimate.covariance * J.transpose();
  return other;
}

TEST(PoseFilter, ThePivotIsBookkeepingOnly) {
  // No process noise: the model's white accelerations are the pivot's own, so they depend on it.
  PoseFilterParameters parameters;
  parameters.acceleration_density_mm2_per_s3 = 0;
  parameters.angular_acceleration_density_rad2_per_s3 = 0;
  PoseFilter fixed;
  PoseFilter switching;
  Noise noise(3);
  for (int frame = 0; frame < 20; ++frame) {
    const nanoseconds t = frame * kFramePeriod;
    const double s = seconds(t);
    const MotionEstimate estimate =
        noise.measure(t, moved(Vector3d(2 * s, 0, 0), turn(Vector3d(0, 0.02 * s, 0.05 * s))));
    fixed.correct(estimate, parameters);
    switching.correct(frame < 10 ? estimate : about(estimate, Vector3d(5, -3, 190)), parameters);
  }
  const Vector3d target(2, 8, 205);
  const nanoseconds now = fixed.t_newest() + milliseconds(40);
  const auto a = fixed.predict(now, parameters, target);
  const auto b = switching.predict(now, parameters, target);
  ASSERT_TRUE(a && b);
  // What is left is the model: a turning body has one point at constant velocity, not two.
  EXPECT_LT((a->T_camera_site * target - b->T_camera_site * target).norm(), 2e-3);
  EXPECT_LT((a->covariance - b->covariance).norm(), 1e-3 * a->covariance.norm());
  EXPECT_NEAR(a->speed_mm_per_s, b->speed_mm_per_s, 1e-2 * a->speed_mm_per_s);
}

}  // namespace
}  // namespace holdfast::rt
