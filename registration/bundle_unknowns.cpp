// SPDX-License-Identifier: Apache-2.0
#include "registration/bundle_unknowns.hpp"

#include <algorithm>
#include <cmath>

#include <opencv2/calib3d.hpp>

namespace holdfast::registration::bundle {
namespace {

Camera camera_of(const cv::Matx33d& K, const cv::Mat& distortion) {
  Camera camera = {std::log(K(0, 0)), std::log(K(1, 1)), K(0, 2), K(1, 2)};
  const auto n = static_cast<int>(distortion.total());
  for (int i = 0; i < std::min(n, 5); ++i)
    camera[4 + static_cast<std::size_t>(i)] = distortion.at<double>(i);
  for (int i = 8; i < std::min(n, 12); ++i)
    camera[1 + static_cast<std::size_t>(i)] = distortion.at<double>(i);
  return camera;
}

void write_camera(const Camera& camera, int coefficients, cv::Matx33d& K, cv::Mat& distortion) {
  K = {std::exp(camera[0]), 0, camera[2], 0, std::exp(camera[1]), camera[3], 0, 0, 1};
  // A new array: assigning zeros() would write into one that copies of the record share.
  distortion = cv::Mat(1, coefficients, CV_64F, cv::Scalar(0));
  for (int i = 0; i < 5; ++i) distortion.at<double>(i) = camera[4 + static_cast<std::size_t>(i)];
  for (int i = 8; i < coefficients; ++i)
    distortion.at<double>(i) = camera[1 + static_cast<std::size_t>(i)];
}

}  // namespace

ZoomUnknowns from_opencv(const ZoomCalibration& zoom) {
  ZoomUnknowns unknowns;
  unknowns.left = camera_of(zoom.camera_matrix_left, zoom.distortion_left);
  unknowns.right = camera_of(zoom.camera_matrix_right, zoom.distortion_right);
  cv::Vec3d rotation;
  cv::Rodrigues(zoom.R, rotation);
  unknowns.extrinsics = {rotation[0], rotation[1], rotation[2], zoom.T[0], zoom.T[1], zoom.T[2]};
  return unknowns;
}

ZoomCalibration to_opencv(const ZoomUnknowns& zoom, int coefficients, const ZoomCalibration& like) {
  ZoomCalibration calibration = like;
  write_camera(zoom.left, coefficients, calibration.camera_matrix_left,
               calibration.distortion_left);
  write_camera(zoom.right, coefficients, calibration.camera_matrix_right,
               calibration.distortion_right);
  const auto& e = zoom.extrinsics;
  cv::Rodrigues(cv::Vec3d(e[0], e[1], e[2]), calibration.R);
  calibration.T = {e[3], e[4], e[5]};
  return calibration;
}

Eigen::MatrixXd to_opencv_covariance(const ZoomUnknowns& zoom, int coefficients,
                                     const Eigen::MatrixXd& covariance) {
  const int n = coefficients;
  Eigen::MatrixXd change = Eigen::MatrixXd::Zero(2 * (4 + n) + kExtrinsics, kOfZoom);
  for (Eigen::Index side = 0; side < 2; ++side) {
    const Camera& camera = side == 0 ? zoom.left : zoom.right;
    const Eigen::Index row = side * (4 + n), column = side * kIntrinsics;
    for (Eigen::Index i = 0; i < 9; ++i)
      change(row + i, column + i) = i < 2 ? std::exp(camera.at(static_cast<std::size_t>(i))) : 1;
    for (Eigen::Index i = 12; i < 4 + n; ++i) change(row + i, column + i - 3) = 1;
  }
  change.bottomRightCorner(kExtrinsics, kExtrinsics).setIdentity();
  const Eigen::MatrixXd result = change * covariance * change.transpose();
  return 0.5 * (result + result.transpose());
}

}  // namespace holdfast::registration::bundle
