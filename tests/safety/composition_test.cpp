// SPDX-License-Identifier: Apache-2.0
#include "safety/composition.hpp"

#include <cmath>
#include <limits>
#include <random>

#include <gtest/gtest.h>

#include "safety/numbers.hpp"
#include "tests/safety/good_inputs.hpp"

namespace holdfast::safety {
namespace {

using Vector6d = Eigen::Matrix<double, 6, 1>;

Eigen::Isometry3d pose(double angle_rad_, const Eigen::Vector3d& axis, const Eigen::Vector3d& t) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = Eigen::AngleAxisd(angle_rad_, axis.normalized()).toRotationMatrix();
  T.translation() = t;
  return T;
}

/// A full covariance with correlations.
Matrix6d covariance(unsigned seed, double sigma_mm, double sigma_rad) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  Matrix6d root;
  for (double& element : root.reshaped()) element = normal(random) / 3;
  Vector6d scale;
  scale << Eigen::Vector3d::Constant(sigma_mm), Eigen::Vector3d::Constant(sigma_rad);
  return scale.asDiagonal() * (root * root.transpose()) * scale.asDiagonal();
}

Eigen::Matrix3d exponential(const Eigen::Vector3d& r) {
  const double angle = r.norm();
  if (angle == 0) return Eigen::Matrix3d::Identity();
  return Eigen::AngleAxisd(angle, r / angle).toRotationMatrix();
}

class CompositionTest : public ::testing::Test, public test::GateDriver {
 protected:
  CompositionTest() {
    inputs.T_robot_camera = pose(1.1, {1, 2, -1}, {300, -50, 20});
    inputs.prediction->T_camera_site = pose(0.2, {0.3, -1, 0.5}, {3, -2, 1});
    inputs.prediction->covariance = covariance(1, 0.03, 2e-4);
    inputs.registration.T_site_ct = pose(2.0, {-1, 0.2, 0.4}, {10, -20, 180});
    inputs.registration.covariance = covariance(2, 0.03, 3e-4);
  }
  Inputs inputs = test::good_inputs({});
};

/// The same covariance by drawing errors as the two definitions state them and composing poses.
TEST_F(CompositionTest, CovarianceAgreesWithSampledErrors) {
  RecordProperty("requirement", "SR-12,SR-31");
  const PredictedPose& prediction = *inputs.prediction;
  const RegistrationInput& registration = inputs.registration;
  const Eigen::Matrix3d R_rc = inputs.T_robot_camera.linear();
  const Eigen::Vector3d p_target_ct =
      registration.T_site_ct.inverse() * registration.p_target_site_mm;
  const Eigen::Isometry3d T_robot_ct =
      inputs.T_robot_camera * prediction.T_camera_site * registration.T_site_ct;
  const Eigen::Vector3d p_target_camera = prediction.T_camera_site * registration.p_target_site_mm;

  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  const Matrix6d root_prediction = prediction.covariance.llt().matrixL();
  const Matrix6d root_registration = registration.covariance.llt().matrixL();
  const auto draw = [&](const Matrix6d& root) {
    Vector6d unit;
    for (double& element : unit) element = normal(random);
    return Vector6d(root * unit);
  };
  constexpr int kSamples = 100'000;
  Matrix6d sum = Matrix6d::Zero();
  for (int i = 0; i < kSamples; ++i) {
    const Vector6d e_registration = draw(root_registration);
    Eigen::Isometry3d T_site_ct = registration.T_site_ct;
    T_site_ct.linear() = exponential(e_registration.tail<3>()) * T_site_ct.linear();
    T_site_ct.translation() += e_registration.head<3>();
    const Vector6d e_prediction = draw(root_prediction);
    Eigen::Isometry3d T_error = Eigen::Isometry3d::Identity();  // turns about the target
    T_error.linear() = exponential(e_prediction.tail<3>());
    T_error.translation() =
        p_target_camera + e_prediction.head<3>() - T_error.linear() * p_target_camera;
    const Eigen::Isometry3d T_sample =
        inputs.T_robot_camera * T_error * prediction.T_camera_site * T_site_ct;
    const Eigen::AngleAxisd turn(T_sample.linear() * T_robot_ct.linear().transpose());
    Vector6d error;
    error << T_sample * p_target_ct - T_robot_ct * p_target_ct, turn.angle() * turn.axis();
    sum += error * error.transpose();
  }
  const Matrix6d sampled = sum / kSamples;
  const Matrix6d computed = rotated(R_rc, covariance_at_target(prediction, registration));
  const Vector6d scale = computed.diagonal().cwiseSqrt();
  const Matrix6d difference =
      scale.cwiseInverse().asDiagonal() * (sampled - computed) * scale.cwiseInverse().asDiagonal();
  EXPECT_LT(difference.cwiseAbs().maxCoeff(), 0.03);  // 1/sqrt(100000) = 0.003, ten times that
}

TEST_F(CompositionTest, HandEyeUncertaintyAgreesWithSampledErrors) {
  RecordProperty("requirement", "SR-12,SR-31");
  inputs.hand_eye_sigma = {.t_mm = 0.05, .r_rad = 4e-4};
  const Eigen::Isometry3d T_camera_ct =
      inputs.prediction->T_camera_site * inputs.registration.T_site_ct;
  const Eigen::Vector3d p_target_ct =
      inputs.registration.T_site_ct.inverse() * inputs.registration.p_target_site_mm;
  const Eigen::Isometry3d T_robot_ct = inputs.T_robot_camera * T_camera_ct;
  std::mt19937 random(4);
  std::normal_distribution<double> normal;
  const auto draw = [&](double sigma) {
    return Eigen::Vector3d(sigma * normal(random), sigma * normal(random), sigma * normal(random));
  };
  constexpr int kSamples = 100'000;
  Matrix6d sum = Matrix6d::Zero();
  for (int i = 0; i < kSamples; ++i) {
    Eigen::Isometry3d T_robot_camera = inputs.T_robot_camera;  // turns about the camera
    T_robot_camera.linear() =
        exponential(draw(inputs.hand_eye_sigma.r_rad)) * T_robot_camera.linear();
    T_robot_camera.translation() += draw(inputs.hand_eye_sigma.t_mm);
    const Eigen::Isometry3d T_sample = T_robot_camera * T_camera_ct;
    const Eigen::AngleAxisd turn(T_sample.linear() * T_robot_ct.linear().transpose());
    Vector6d error;
    error << T_sample * p_target_ct - T_robot_ct * p_target_ct, turn.angle() * turn.axis();
    sum += error * error.transpose();
  }
  const Matrix6d added =
      covariance_at_target(inputs) - covariance_at_target(*inputs.prediction, inputs.registration);
  const Matrix6d computed = rotated(inputs.T_robot_camera.linear(), added);
  const Vector6d scale = computed.diagonal().cwiseSqrt().cwiseInverse();
  const Matrix6d difference = scale.asDiagonal() * (sum / kSamples - computed) * scale.asDiagonal();
  EXPECT_LT(difference.cwiseAbs().maxCoeff(), 0.03);  // as above
}

TEST_F(CompositionTest, MeasuredHandEyeCovarianceIsInRobotAxesAboutTheCamera) {
  RecordProperty("requirement", "SR-12,SR-31");
  // A mode in robot axes that moves the target, and one that leaves it where it is.
  const Eigen::Vector3d b_robot =
      inputs.T_robot_camera.linear() *
      (inputs.prediction->T_camera_site * inputs.registration.p_target_site_mm);
  const Eigen::Vector3d turn = 1e-3 * Eigen::Vector3d(0.3, -0.5, 0.8);
  const Matrix6d without = covariance_at_target(*inputs.prediction, inputs.registration);
  for (const Eigen::Vector3d& at_target :
       {Eigen::Vector3d(0.02, -0.05, 0.03), Eigen::Vector3d(0, 0, 0)}) {
    Vector6d mode;
    mode << at_target - turn.cross(b_robot), turn;  // dt + r x b is the target's motion
    inputs.hand_eye_sigma.covariance = mode * mode.transpose();
    const Matrix6d added =
        rotated(inputs.T_robot_camera.linear(), covariance_at_target(inputs) - without);
    Vector6d expected;
    expected << at_target, turn;
    EXPECT_TRUE(added.isApprox(expected * expected.transpose(), 1e-6)) << added;
  }
}

/// Exact, and with arms so short that an error of a millimetre in them shows: sampling does not see
/// it at an arm's usual length.
TEST_F(CompositionTest, ATurnMovesTheTargetByItsCrossProductWithTheArm) {
  RecordProperty("requirement", "SR-12,SR-31");
  const Eigen::Vector3d arm(1, -2, 3);
  constexpr double kSigmaRad = 1e-3;
  inputs.T_robot_camera = inputs.prediction->T_camera_site = Eigen::Isometry3d::Identity();
  inputs.prediction->covariance.setZero();
  inputs.registration.p_target_site_mm = arm;
  inputs.registration.T_site_ct = Eigen::Isometry3d::Identity();
  Eigen::Matrix3d of_all = Eigen::Matrix3d::Zero();
  for (Eigen::Index axis = 0; axis < 3; ++axis) {
    inputs.registration.covariance.setZero();
    inputs.registration.covariance(3 + axis, 3 + axis) = kSigmaRad * kSigmaRad;
    const Eigen::Vector3d moved = kSigmaRad * Eigen::Vector3d::Unit(axis).cross(arm);
    const Matrix6d computed = covariance_at_target(*inputs.prediction, inputs.registration);
    EXPECT_TRUE((computed.topLeftCorner<3, 3>().isApprox(moved * moved.transpose(), 1e-9)));
    of_all += moved * moved.transpose();
  }
  inputs.registration.covariance.setZero();
  inputs.hand_eye_sigma = {};
  inputs.hand_eye_sigma.r_rad = kSigmaRad;
  EXPECT_TRUE((covariance_at_target(inputs).topLeftCorner<3, 3>().isApprox(of_all, 1e-9)));
}

TEST_F(CompositionTest, HandEyeUncertaintyCountsAgainstTheLimit) {
  RecordProperty("requirement", "SR-12,SR-31");
  ASSERT_EQ(to_permitted().mode, Mode::permitted);
  const double arm_mm = 200;  // camera to target, about
  const auto turned = [&](double at_target_mm) {
    return [=](Inputs& in) { in.hand_eye_sigma.r_rad = at_target_mm / arm_mm; };
  };
  const Decision within = step(turned(0.5 * limits.sigma_target_max_mm));
  ASSERT_TRUE(within.approved);
  EXPECT_GT(sigma_max_mm(within.approved->covariance()), 0.5 * limits.sigma_target_max_mm);
  const Decision beyond = step(turned(1.1 * limits.sigma_target_max_mm));
  EXPECT_EQ(beyond.cause, Reason::covariance_exceeded);
}

TEST_F(CompositionTest, MeasuredHandEyeUncertaintyCountsAgainstTheLimit) {
  RecordProperty("requirement", "SR-12,SR-31");
  ASSERT_EQ(to_permitted().mode, Mode::permitted);
  const auto moved = [&](double sigma_mm) {
    return [=](Inputs& in) {
      in.hand_eye_sigma.covariance.setIdentity();
      in.hand_eye_sigma.covariance *= 1e-14;  // as good as no turn
      in.hand_eye_sigma.covariance.topLeftCorner<3, 3>().diagonal().setConstant(sigma_mm *
                                                                                sigma_mm);
    };
  };
  EXPECT_TRUE(step(moved(0.5 * limits.sigma_target_max_mm)).approved);
  EXPECT_EQ(step(moved(1.1 * limits.sigma_target_max_mm)).cause, Reason::covariance_exceeded);
}

TEST_F(CompositionTest, NothingIsJudgedWithoutPredictionOrRegistration) {
  RecordProperty("requirement", "SR-12");
  EXPECT_GT(judged_sigma_mm(inputs), 0);
  Inputs unpredicted = inputs;
  unpredicted.prediction.reset();
  EXPECT_TRUE(std::isnan(judged_sigma_mm(unpredicted)));
  inputs.registration.is_loaded = false;
  EXPECT_TRUE(std::isnan(judged_sigma_mm(inputs)));
}

TEST_F(CompositionTest, ApprovedPoseIsTheProductWithItsCovariance) {
  RecordProperty("requirement", "SR-31");
  const Inputs wanted = inputs;
  limits.displacement_max_mm = 100;  // a large turn about the camera
  ASSERT_EQ(to_permitted().mode, Mode::permitted);
  const Decision decision = step([&](Inputs& in) {
    in.T_robot_camera = wanted.T_robot_camera;
    in.prediction = wanted.prediction;
    in.registration = wanted.registration;
  });
  ASSERT_TRUE(decision.approved) << name(decision.cause);
  const Eigen::Isometry3d T_expected =
      wanted.T_robot_camera * wanted.prediction->T_camera_site * wanted.registration.T_site_ct;
  EXPECT_TRUE(decision.approved->T_robot_ct().isApprox(T_expected, 1e-12));
  const Matrix6d expected = rotated(wanted.T_robot_camera.linear(),
                                    covariance_at_target(*wanted.prediction, wanted.registration));
  EXPECT_TRUE(decision.approved->covariance().isApprox(expected, 1e-12));
}

TEST_F(CompositionTest, RegistrationTurnsAboutTheImageOfTheCtOrigin) {
  RecordProperty("requirement", "SR-31");
  inputs.registration.covariance = Vector6d::Constant(1e-12).asDiagonal();
  inputs.registration.covariance(5, 5) = 1e-6;  // 1 mrad about z
  inputs.registration.p_target_site_mm =
      inputs.registration.T_site_ct.translation() + Eigen::Vector3d(100, 0, 0);
  inputs.prediction->T_camera_site.setIdentity();
  inputs.prediction->covariance = Vector6d::Constant(1e-12).asDiagonal();
  const Matrix6d result = covariance_at_target(*inputs.prediction, inputs.registration);
  EXPECT_NEAR(std::sqrt(result(1, 1)), 0.1, 1e-6);  // 100 mm · 1 mrad, along y
  EXPECT_LT(result(0, 0), 1e-10);
  EXPECT_GT(result(1, 5), 0);
}

TEST(SigmaMax, IsAlongTheLargestAxisWhateverItsDirection) {
  RecordProperty("requirement", "SR-12");
  Matrix6d along_axes = Matrix6d::Identity();
  along_axes.diagonal().head<3>() << 0.01, 0.09, 0.04;
  EXPECT_NEAR(sigma_max_mm(along_axes), 0.3, 1e-12);
  const Eigen::Matrix3d R = Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 1, 1).normalized()).matrix();
  EXPECT_NEAR(sigma_max_mm(rotated(R, along_axes)), 0.3, 1e-12);
}

TEST(SigmaMax, OfNoNumberIsInfinite) {
  Matrix6d bad = Matrix6d::Identity();
  bad(1, 2) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(sigma_max_mm(bad), std::numeric_limits<double>::infinity());
}

TEST(SigmaMax, OfANegativeVarianceRefuses) {
  EXPECT_TRUE(exceeds(sigma_max_mm(-Matrix6d::Identity()), 1e9));
}

TEST(Angle, IsExactFromNothingToHalfATurn) {
  const Eigen::Vector3d axis = Eigen::Vector3d(1, -2, 0.5).normalized();
  for (const double angle : {0.0, 1e-9, 1e-4, 0.35, 1.5, 3.0, 3.14159}) {
    EXPECT_NEAR(angle_rad(Eigen::AngleAxisd(angle, axis).toRotationMatrix()), angle, 1e-12);
  }
}

TEST(Displacement, IsOfTheTargetNotOfTheOrigin) {
  const Eigen::Vector3d p_target(0, 0, 200);
  const Eigen::Isometry3d T_about_camera = pose(0.01, {1, 0, 0}, {0, 0, 0});
  EXPECT_NEAR(displacement_mm(T_about_camera, p_target), 2 * 200 * std::sin(0.005), 1e-9);
  Eigen::Isometry3d T_about_target = T_about_camera;
  T_about_target.translation() = p_target - T_about_camera.linear() * p_target;
  EXPECT_NEAR(displacement_mm(T_about_target, p_target), 0, 1e-9);
}

}  // namespace
}  // namespace holdfast::safety
