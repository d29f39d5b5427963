// SPDX-License-Identifier: Apache-2.0
#include "registration/working_volume.hpp"

#include <cmath>

#include <gtest/gtest.h>

namespace holdfast::registration {
namespace {

constexpr int kWidth = 2456, kHeight = 2054;

/// Toed in towards 200 mm; what a principal point and the camera's turn leave open is in the
/// covariance, with a little of everything else.
ZoomCalibration microscope() {
  ZoomCalibration zoom;
  zoom.zoom = 1.3;
  zoom.focus_mm = 200;
  zoom.camera_matrix_left = {4000, 0, 1227, 0, 4000, 1026, 0, 0, 1};
  zoom.camera_matrix_right = {4010, 0, 1220, 0, 4010, 1030, 0, 0, 1};
  zoom.distortion_left = cv::Mat::zeros(1, 5, CV_64F);
  zoom.distortion_right = cv::Mat::zeros(1, 5, CV_64F);
  const double c = std::cos(0.12), s = std::sin(0.12);
  zoom.R = {c, 0, s, 0, 1, 0, -s, 0, c};
  zoom.T = {-24, 0.1, 1.4};
  Eigen::VectorXd sigma(24);
  sigma << 4, 4, 0.1, 0.1, 1e-3, 1e-3, 1e-5, 1e-5, 1e-3, 4, 4, 0.1, 0.1, 1e-3, 1e-3, 1e-5, 1e-5,
      1e-3, 1e-5, 1e-5, 1e-5, 2e-3, 2e-3, 2e-3;
  Eigen::VectorXd wander = Eigen::VectorXd::Zero(24);  // both turn, both principal points follow
  wander[2] = wander[11] = 8;
  zoom.parameter_covariance = wander * wander.transpose();
  zoom.parameter_covariance.diagonal() += 0.01 * sigma.cwiseAbs2();
  return zoom;
}

double rms(const Eigen::MatrixXd& moves) {
  return std::sqrt(3 * moves.squaredNorm() / static_cast<double>(moves.rows()));
}

TEST(WorkingVolume, HoldsWhatBothCamerasSee) {
  const WorkingVolume volume = working_volume(microscope(), kWidth, kHeight, 200);
  EXPECT_GT(volume.p_camera_mm.size(), 40U);
  for (const cv::Point2d& p : volume.right) {
    EXPECT_GE(p.x, 0);
    EXPECT_LE(p.x, kWidth - 1);
  }
}

TEST(WorkingVolume, ARigidMotionLeavesNothing) {
  const WorkingVolume volume = working_volume(microscope(), kWidth, kHeight, 200);
  const Eigen::MatrixXd motions = rigid_motions(volume.p_camera_mm);
  EXPECT_LT(without_rigid(volume.p_camera_mm, motions).norm(), 1e-9 * motions.norm());
}

TEST(CovarianceInOwnFrame, ForgetsWhereTheFrameStandsAndNothingElse) {
  ZoomCalibration zoom = microscope();
  const WorkingVolume volume = working_volume(zoom, kWidth, kHeight, 200, {0.8, 0.05});
  const auto moves = [&] {
    return displacements(volume, zoom, covariance_root(zoom.parameter_covariance));
  };
  const double all_before = rms(moves());
  const double form_before = rms(without_rigid(volume.p_camera_mm, moves()));
  zoom.parameter_covariance = covariance_in_own_frame(zoom, kWidth, kHeight, 200);
  const double all_after = rms(moves());
  const double form_after = rms(without_rigid(volume.p_camera_mm, moves()));
  EXPECT_GT(all_before, 0.3);
  EXPECT_LT(all_after, 1.1 * form_before);
  EXPECT_NEAR(form_after, form_before, 0.2 * form_before);
}

TEST(CovarianceRoot, ItsOuterProductsSumToTheCovariance) {
  const Eigen::MatrixXd covariance = microscope().parameter_covariance;
  const Eigen::MatrixXd root = covariance_root(covariance);
  EXPECT_LT((root * root.transpose() - covariance).norm(), 1e-9 * covariance.norm());
}

}  // namespace
}  // namespace holdfast::registration
