// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/optics.hpp"

#include <cmath>

#include <gtest/gtest.h>

#include "rt/core/error.hpp"
#include "tests/sim/or/board.hpp"
#include "tests/sim/or/calibration_error.hpp"
#include "tests/sim/or/ideal_calibration.hpp"

namespace holdfast::sim {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

TEST(OpticalChannel, SightLineOfAPixelIsSeenAtThatPixel) {
  for (const double zoom : {1.1, 1.27, 1.5}) {
    const StereoOptics optics = Microscope().at(zoom, 3);
    for (const OpticalChannel* channel : {&optics.left, &optics.right})
      for (double y = 0; y < kSensorHeightPx; y += 205)
        for (double x = 0; x < kSensorWidthPx; x += 245) {
          const SightLine line = channel->sight_line({x, y});
          for (const double t : {150.0, 200.0, 260.0}) {
            const Vector2d pixel = channel->project(line.origin_mm + t * line.direction);
            EXPECT_NEAR(pixel.x(), x, 1e-8);
            EXPECT_NEAR(pixel.y(), y, 1e-8);
          }
        }
  }
}

TEST(OpticalChannel, SeesNothingBehindItself) {
  EXPECT_TRUE(Microscope().at(1.3).left.project({1, 2, -5}).hasNaN());
}

TEST(Microscope, HasThePixelScaleOfPaperA) {
  for (const auto& [zoom, low, high] : {std::tuple{1.1, 16.5, 17.5}, {1.5, 22.5, 23.6}}) {
    const StereoOptics optics = Microscope().at(zoom);
    const double px_per_mm = optics.left.focal_px() / optics.focus_mm;
    EXPECT_GT(px_per_mm, low) << zoom;
    EXPECT_LT(px_per_mm, high) << zoom;
  }
}

TEST(Microscope, BothAxesMeetNearTheFocus) {
  for (std::uint32_t seed = 1; seed < 6; ++seed) {
    OpticsParameters parameters;
    parameters.seed = seed;
    const StereoOptics optics = Microscope(parameters).at(1.3);
    const Vector3d focus(0, 0, optics.focus_mm);
    const Vector2d middle(0.5 * kSensorWidthPx, 0.5 * kSensorHeightPx);
    EXPECT_LT((optics.left.project(optics.T_head_left.inverse() * focus) - middle).norm(), 60);
    EXPECT_LT((optics.right.project(optics.T_head_right.inverse() * focus) - middle).norm(), 60);
  }
}

TEST(Microscope, IsNeverTheSameTwice) {
  OpticsParameters one, two;
  two.seed = 2;
  const StereoOptics a = Microscope(one).at(1.3), b = Microscope(two).at(1.3);
  EXPECT_GT(std::abs(a.T_right_left().translation().norm() - b.T_right_left().translation().norm()),
            0.01);
  EXPECT_GT(std::abs(a.focus_mm - b.focus_mm), 0.01);
  EXPECT_EQ(Microscope(one).at(1.3).left.focal_px(), a.left.focal_px());
}

TEST(Microscope, SeatsEachVisitAFractionOfAPixelApart) {
  const Microscope microscope;
  const Vector3d p(10, -8, 205);
  const Vector2d mean = microscope.at(1.3).left.project(p);
  double sum = 0;
  constexpr int kVisits = 200;
  for (std::uint32_t visit = 1; visit <= kVisits; ++visit) {
    const Vector2d shift = microscope.at(1.3, visit).left.project(p) - mean;
    EXPECT_LT(shift.norm(), 1.0);
    sum += shift.squaredNorm() / 2;
  }
  EXPECT_NEAR(std::sqrt(sum / kVisits), 0.15, 0.03);
}

TEST(Microscope, ChangesSmoothlyWithZoom) {
  const Microscope microscope;
  const Vector3d p(20, 15, 200);
  const auto at = [&](double zoom) { return microscope.at(zoom).right.project(p); };
  for (double zoom = 1.12; zoom < 1.48; zoom += 0.01) {
    const Vector2d second = at(zoom - 0.01) - 2 * at(zoom) + at(zoom + 0.01);
    EXPECT_LT(second.norm(), 0.2) << zoom;
  }
}

TEST(Microscope, RefusesAZoomItDoesNotHave) {
  EXPECT_THROW((void)Microscope().at(1.6), InputError);
  EXPECT_THROW((void)Microscope().at(std::nan("")), InputError);
}

TEST(IdealCalibration, LeavesAFewHundredthsOfAPixelThatFiveCoefficientsCannotHold) {
  for (std::uint32_t seed = 1; seed < 4; ++seed) {
    OpticsParameters parameters;
    parameters.seed = seed;
    const StereoOptics optics = Microscope(parameters).at(1.1);
    const IdealCalibration ideal = ideal_calibration(optics);
    EXPECT_GT(ideal.model.rms_px, 0.015) << seed;
    EXPECT_LT(ideal.model.rms_px, 0.12) << seed;
    const CalibrationError error = calibration_error(ideal.model, optics);
    EXPECT_GT(error.non_rigid_rms_mm, 0.002) << seed;
    EXPECT_LT(error.non_rigid_rms_mm, 0.025) << seed;
  }
}

TEST(IdealCalibration, IsExactForALensThatTheModelContains) {
  OpticsParameters parameters;
  parameters.irregularity = 0;
  const StereoOptics optics = Microscope(parameters).at(1.3);
  const IdealCalibration ideal = ideal_calibration(optics);
  EXPECT_LT(ideal.model.rms_px, 1e-3);
  const CalibrationError error = calibration_error(ideal.model, optics);
  EXPECT_LT(error.non_rigid_rms_mm, 5e-4);
  EXPECT_NEAR(error.scale, 1, 1e-5);
  EXPECT_LT((ideal.T_camera_head * optics.T_head_left).translation().norm(), 0.02);
}

TEST(CalibrationError, GrowsWithAWrongCalibration) {
  const StereoOptics optics = Microscope().at(1.3);
  registration::ZoomCalibration model = ideal_calibration(optics).model;
  const double before = calibration_error(model, optics).non_rigid_rms_mm;
  model.camera_matrix_left(0, 0) *= 1.001;
  EXPECT_GT(calibration_error(model, optics).non_rigid_rms_mm, before + 0.01);
}

TEST(BoardPoses, KeepTheWholeBoardInBothImagesAtEveryZoom) {
  const Board board;
  for (const double zoom : {1.1, 1.5}) {
    const StereoOptics optics = Microscope().at(zoom);
    const auto poses = board_poses(board, optics, {});
    ASSERT_EQ(poses.size(), 19U);
    double steepest = 0;
    for (const Eigen::Isometry3d& T_head_board : poses) {
      steepest = std::max(steepest, std::acos(T_head_board.linear()(2, 2)));
      for (const Vector3d& corner : board.corners()) {
        const Vector3d p = T_head_board * corner;
        const Vector2d left = optics.left.project(optics.T_head_left.inverse() * p);
        const Vector2d right = optics.right.project(optics.T_head_right.inverse() * p);
        for (const Vector2d& pixel : {left, right}) {
          EXPECT_GT(pixel.minCoeff(), 25);
          EXPECT_LT(pixel.x(), kSensorWidthPx - 25);
          EXPECT_LT(pixel.y(), kSensorHeightPx - 25);
        }
      }
    }
    EXPECT_GT(steepest, 0.85);
  }
}

}  // namespace
}  // namespace holdfast::sim
