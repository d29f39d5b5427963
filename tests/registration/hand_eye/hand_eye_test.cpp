// SPDX-License-Identifier: Apache-2.0
#include "registration/hand_eye.hpp"

#include <cmath>

#include <gtest/gtest.h>

#include "tests/registration/hand_eye/drawn_spots.hpp"

namespace holdfast::registration {
namespace {

using test::draw_hand_eye;
using test::DrawnHandEye;
using test::DrawnSpots;

DrawnSpots exact(bool has_beams = false) {
  DrawnSpots options;
  options.pixel_sigma_px = options.robot_sigma_mm = options.robot_sigma_rad = 0;
  options.calibration_sigma = 0;
  options.has_beams = has_beams;
  return options;
}

double error_mm(const HandEye& found, const DrawnHandEye& drawn, const Eigen::Vector3d& p) {
  return (found.T_robot_camera * p - drawn.T_robot_camera * p).norm();
}

void expect_exact(const DrawnSpots& options) {
  const DrawnHandEye drawn = draw_hand_eye(options);
  const HandEye found = find_hand_eye(drawn.input);
  ASSERT_EQ(found.status, HandEyeStatus::found) << found.reason;
  EXPECT_LT(error_mm(found, drawn, {0, 0, 200}), 1e-5);
  EXPECT_LT(error_mm(found, drawn, {30, -20, 180}), 1e-5);
  EXPECT_NEAR(found.scale.value, 1, 1e-6);
}

TEST(HandEye, FindsTheTransformFromExactPoints) {
  expect_exact(exact());
}

TEST(HandEye, FindsTheTransformFromExactBeams) {
  expect_exact(exact(true));
}

TEST(HandEye, StatesItsErrorInRobotAxes) {
  const DrawnHandEye drawn = draw_hand_eye({});
  const HandEye found = find_hand_eye(drawn.input);
  ASSERT_EQ(found.status, HandEyeStatus::found) << found.reason;
  // The same from its definition: p_robot = Exp(r)·R·p_camera + t + dt.
  const Eigen::Matrix3d expected =
      target_covariance(found.T_robot_camera, found.covariance, found.p_middle_camera_mm);
  EXPECT_TRUE(found.covariance_middle_mm2.isApprox(expected, 1e-9));
  // Twelve spots of 0.05 mm and an uncertain stereo base: hundredths of a millimetre in the middle,
  // far more at the camera's own origin, 200 mm from all of them.
  const double middle_mm = std::sqrt(found.covariance_middle_mm2.trace());
  EXPECT_GT(middle_mm, 0.02);
  EXPECT_LT(middle_mm, 0.12);
  EXPECT_GT(std::sqrt(found.covariance.topLeftCorner<3, 3>().trace()), 3 * middle_mm);
  EXPECT_LT(error_mm(found, drawn, found.p_middle_camera_mm), 4 * middle_mm);
}

TEST(HandEye, GrowsLessCertainWithTheCalibration) {
  DrawnHandEye drawn = draw_hand_eye(exact());
  const HandEye sure = find_hand_eye(drawn.input);
  drawn.input.calibration.parameter_covariance *= 9;
  const HandEye unsure = find_hand_eye(drawn.input);
  ASSERT_EQ(sure.status, HandEyeStatus::found) << sure.reason;
  ASSERT_EQ(unsure.status, HandEyeStatus::found) << unsure.reason;
  EXPECT_GT(unsure.covariance_middle_mm2.trace(), 2 * sure.covariance_middle_mm2.trace());
}

struct Mistake {
  HandEyeStatus status;
  const char* part;  ///< of the reason
  void (*make)(DrawnHandEye&);
};

TEST(HandEye, RefusesEachMistakeByName) {
  using S = HandEyeStatus;
  const Mistake mistakes[] = {
      {S::too_few, "5 spots, at least 6", [](DrawnHandEye& d) { d.input.spots.resize(5); }},
      {S::too_close, "s01 and s02 lie",
       [](DrawnHandEye& d) {
         d.input.spots[1] = d.input.spots[0];
         d.input.spots[1].name = "s02";
       }},
      {S::spot_displaced, "s04 lies",
       [](DrawnHandEye& d) { d.input.spots[3].robot.point_mm.y() += 1.5; }},
      {S::mirrored, "left-handed",
       [](DrawnHandEye& d) {
         for (HandEyeSpot& s : d.input.spots) s.robot.point_mm.y() = -s.robot.point_mm.y();
       }},
      {S::other_scale, "another unit",
       [](DrawnHandEye& d) {
         for (HandEyeSpot& s : d.input.spots) s.robot.point_mm /= 1000;
       }},
      {S::other_scale, "another zoom",
       [](DrawnHandEye& d) {  // 1.3 was set, the images show 1.4
         auto& zoom = d.input.calibration;
         for (auto* K : {&zoom.camera_matrix_left, &zoom.camera_matrix_right})
           (*K)(0, 0) = (*K)(1, 1) = (*K)(0, 0) / 1.077;
       }},
      {S::other_calibration, "the two images disagree",
       [](DrawnHandEye& d) { d.input.spots[5].right.centre_px.y() += 3; }},
      {S::other_calibration, "must be within half of the working distance",
       [](DrawnHandEye& d) {
         d.input.limits.largest_epipolar_px = 20;
         for (HandEyeSpot& s : d.input.spots) s.right.centre_px.x() -= 700;
       }},
      {S::poor_fit, "contradict each other",
       [](DrawnHandEye& d) {
         double sign = 0.7;
         for (HandEyeSpot& s : d.input.spots)
           s.robot.point_mm += (sign = -sign) * Eigen::Vector3d(1, 0.5, 1);
       }},
      {S::target_uncertain, "in the middle of the working volume",
       [](DrawnHandEye& d) {
         for (HandEyeSpot& s : d.input.spots) s.robot.sigma_mm = 0.7;
       }},
      {S::invalid_numbers, "not finite",
       [](DrawnHandEye& d) { d.input.spots[2].robot.point_mm.x() = std::nan(""); }},
      {S::invalid_numbers, "not finite",
       [](DrawnHandEye& d) { d.input.spots[2].robot.sigma_mm = 0; }},
      {S::invalid_numbers, "parameter_covariance",
       [](DrawnHandEye& d) { d.input.calibration.parameter_covariance.resize(0, 0); }},
  };
  for (const Mistake& mistake : mistakes) {
    DrawnHandEye drawn = draw_hand_eye({});
    mistake.make(drawn);
    const HandEye found = find_hand_eye(drawn.input);
    EXPECT_EQ(found.status, mistake.status) << mistake.part << "; got: " << found.reason;
    EXPECT_NE(found.reason.find(mistake.part), std::string::npos) << found.reason;
  }
}

TEST(HandEye, RefusesSpotsInAPlane) {
  DrawnSpots options;
  options.relief_mm = 0;
  EXPECT_EQ(find_hand_eye(draw_hand_eye(options).input).status, HandEyeStatus::flat);
}

TEST(HandEye, RefusesSpotsInALine) {
  DrawnSpots options;
  options.height_mm = 0.5;
  options.relief_mm = 0.2;
  DrawnHandEye drawn = draw_hand_eye(options);
  drawn.input.limits.least_distance_mm = 0;
  EXPECT_EQ(find_hand_eye(drawn.input).status, HandEyeStatus::collinear);
}

TEST(HandEye, RefusesParallelBeams) {
  DrawnHandEye drawn = draw_hand_eye(exact(true));
  const Eigen::Vector3d direction = drawn.input.spots[0].robot.direction.value();
  for (HandEyeSpot& spot : drawn.input.spots) {
    // Through the same spots, from wherever that leads.
    spot.robot.point_mm =
        drawn.T_robot_camera * test::triangulated(drawn.input, spot) - 150 * direction;
    spot.robot.direction = direction;
  }
  EXPECT_EQ(find_hand_eye(drawn.input).status, HandEyeStatus::target_uncertain);
}

TEST(HandEye, RefusesBeamsThatLeaveTheZoomOpen) {
  DrawnHandEye drawn = draw_hand_eye(exact(true));
  const Eigen::Vector3d pivot = drawn.T_robot_camera * Eigen::Vector3d(10, 5, -30);
  for (HandEyeSpot& spot : drawn.input.spots) {
    const Eigen::Vector3d q = drawn.T_robot_camera * test::triangulated(drawn.input, spot);
    spot.robot.point_mm = pivot;
    spot.robot.direction = (q - pivot).normalized();
  }
  const HandEye found = find_hand_eye(drawn.input);
  EXPECT_EQ(found.status, HandEyeStatus::scale_unknown) << found.reason;
}

TEST(HandEye, NamesABeamThatContradictsTheOthers) {
  DrawnSpots options;
  options.has_beams = true;
  DrawnHandEye drawn = draw_hand_eye(options);
  drawn.input.limits.largest_sigma_mm = 0.3;
  ASSERT_EQ(find_hand_eye(drawn.input).status, HandEyeStatus::found)
      << find_hand_eye(drawn.input).reason;
  drawn.input.spots[6].robot.point_mm += Eigen::Vector3d(0.9, 1.2, -0.4);
  const HandEye found = find_hand_eye(drawn.input);
  EXPECT_EQ(found.status, HandEyeStatus::spot_displaced) << found.reason;
  EXPECT_EQ(found.reason.substr(0, 3), "s07");
}

}  // namespace
}  // namespace holdfast::registration
