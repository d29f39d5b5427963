// SPDX-License-Identifier: Apache-2.0
// Part of hand_eye: the spots' places in space, and what is not known of them.
#include "registration/hand_eye.hpp"
#include "registration/triangulation.hpp"
#include "registration/working_volume.hpp"

namespace holdfast::registration {
namespace {

cv::Point2d pixel(const ImageSpot& spot) {
  return {spot.centre_px.x(), spot.centre_px.y()};
}

/// What a step of each image's centre does to the point: 3x4.
Eigen::Matrix<double, 3, 4> image_jacobian(const HandEyeSpot& spot, const ZoomCalibration& zoom) {
  constexpr double kStepPx = 0.01;
  std::vector<cv::Point2d> left(8, pixel(spot.left)), right(8, pixel(spot.right));
  for (std::size_t k = 0; k < 4; ++k)
    for (std::size_t way = 0; way < 2; ++way) {
      cv::Point2d& p = (k < 2 ? left : right)[2 * k + way];
      (k % 2 == 0 ? p.x : p.y) += way == 0 ? kStepPx : -kStepPx;
    }
  const auto moved = triangulate(left, right, zoom);
  Eigen::Matrix<double, 3, 4> jacobian;
  for (std::size_t k = 0; k < 4; ++k)
    jacobian.col(static_cast<Eigen::Index>(k)) =
        (moved[2 * k].p_camera_mm - moved[2 * k + 1].p_camera_mm) / (2 * kStepPx);
  return jacobian;
}

}  // namespace

std::vector<TriangulatedPoint> triangulated_spots(const HandEyeInput& input) {
  std::vector<cv::Point2d> left, right;
  for (const HandEyeSpot& spot : input.spots) {
    left.push_back(pixel(spot.left));
    right.push_back(pixel(spot.right));
  }
  return triangulate(left, right, input.calibration);
}

std::vector<Eigen::Vector3d> locate_spots(const HandEyeInput& input,
                                          Eigen::MatrixXd& joint_covariance_mm2) {
  WorkingVolume spots;  // as places of a volume: their moves with the calibration are known there
  for (const HandEyeSpot& spot : input.spots) {
    spots.left.push_back(pixel(spot.left));
    spots.right.push_back(pixel(spot.right));
  }
  for (const TriangulatedPoint& point : triangulate(spots.left, spots.right, input.calibration))
    spots.p_camera_mm.push_back(point.p_camera_mm);
  const Eigen::MatrixXd moves = displacements(
      spots, input.calibration, covariance_root(input.calibration.parameter_covariance));
  joint_covariance_mm2 = moves * moves.transpose();
  for (std::size_t i = 0; i < input.spots.size(); ++i) {
    const auto jacobian = image_jacobian(input.spots[i], input.calibration);
    Eigen::Matrix4d noise = Eigen::Matrix4d::Zero();
    noise.topLeftCorner<2, 2>() = input.spots[i].left.covariance_px2;
    noise.bottomRightCorner<2, 2>() = input.spots[i].right.covariance_px2;
    const auto at = static_cast<Eigen::Index>(3 * i);
    joint_covariance_mm2.block<3, 3>(at, at) += jacobian * noise * jacobian.transpose();
  }
  return spots.p_camera_mm;
}

}  // namespace holdfast::registration
