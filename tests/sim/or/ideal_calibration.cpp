// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/ideal_calibration.hpp"

#include <opencv2/calib3d.hpp>

namespace holdfast::sim {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

bool is_on_sensor(const Vector2d& p) {
  return p.x() >= 0 && p.y() >= 0 && p.x() <= kSensorWidthPx - 1 && p.y() <= kSensorHeightPx - 1;
}

struct Fit {
  cv::Matx33d camera_matrix;
  cv::Mat distortion;
  Eigen::Isometry3d T_camera_head = Eigen::Isometry3d::Identity();
  double rms_px = 0;
};

Fit fit(const OpticalChannel& channel, const Eigen::Isometry3d& T_head_camera,
        const std::vector<Vector3d>& points_head) {
  const Eigen::Isometry3d T_true_head = T_head_camera.inverse();
  std::vector<cv::Point3f> points;
  std::vector<cv::Point2f> pixels;
  for (const Vector3d& p_head : points_head) {
    const Vector3d p = T_true_head * p_head;
    const Vector2d pixel = channel.project(p);
    points.emplace_back(static_cast<float>(p.x()), static_cast<float>(p.y()),
                        static_cast<float>(p.z()));
    pixels.emplace_back(static_cast<float>(pixel.x()), static_cast<float>(pixel.y()));
  }
  cv::Mat camera = (cv::Mat_<double>(3, 3) << channel.focal_px(), 0, 0.5 * (kSensorWidthPx - 1), 0,
                    channel.focal_px(), 0.5 * (kSensorHeightPx - 1), 0, 0, 1);
  cv::Mat distortion = cv::Mat::zeros(1, 5, CV_64F);
  std::vector<cv::Mat> rotations, translations;
  Fit result;
  result.rms_px = cv::calibrateCamera(
      std::vector<std::vector<cv::Point3f>>{points}, std::vector<std::vector<cv::Point2f>>{pixels},
      cv::Size(kSensorWidthPx, kSensorHeightPx), camera, distortion, rotations, translations,
      cv::CALIB_USE_INTRINSIC_GUESS,
      cv::TermCriteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 500, 1e-14));
  cv::Matx33d R;
  cv::Rodrigues(rotations[0], R);
  Eigen::Isometry3d T_camera_true = Eigen::Isometry3d::Identity();
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) T_camera_true.linear()(i, j) = R(i, j);
    T_camera_true.translation()[i] = translations[0].at<double>(i);
  }
  result.camera_matrix = camera;
  result.distortion = distortion.reshape(1, 1);
  result.T_camera_head = T_camera_true * T_true_head;
  return result;
}

}  // namespace

std::vector<Vector3d> working_volume(const StereoOptics& optics, double depth_mm, int columns,
                                     int rows, int layers) {
  // A little wider than the field at the focal plane; what a camera does not see is left out.
  const double half_width = 0.53 * kSensorWidthPx / optics.left.focal_px() * optics.focus_mm;
  const double half_height = 0.53 * kSensorHeightPx / optics.left.focal_px() * optics.focus_mm;
  const Eigen::Isometry3d T_left_head = optics.T_head_left.inverse();
  const Eigen::Isometry3d T_right_head = optics.T_head_right.inverse();
  const auto place = [](int i, int n) { return n > 1 ? 2.0 * i / (n - 1) - 1 : 0.0; };
  std::vector<Vector3d> points;
  for (int k = 0; k < layers; ++k)
    for (int j = 0; j < rows; ++j)
      for (int i = 0; i < columns; ++i) {
        const Vector3d p(half_width * place(i, columns), half_height * place(j, rows),
                         optics.focus_mm + depth_mm * place(k, layers));
        if (is_on_sensor(optics.left.project(T_left_head * p)) &&
            is_on_sensor(optics.right.project(T_right_head * p)))
          points.push_back(p);
      }
  return points;
}

IdealCalibration ideal_calibration(const StereoOptics& optics) {
  const std::vector<Vector3d> points = working_volume(optics);
  const Fit left = fit(optics.left, optics.T_head_left, points);
  const Fit right = fit(optics.right, optics.T_head_right, points);
  const Eigen::Isometry3d T_right_left = right.T_camera_head * left.T_camera_head.inverse();
  IdealCalibration ideal;
  ideal.T_camera_head = left.T_camera_head;
  registration::ZoomCalibration& m = ideal.model;
  m.zoom = optics.zoom;
  m.focus_mm = optics.focus_mm;
  m.camera_matrix_left = left.camera_matrix;
  m.camera_matrix_right = right.camera_matrix;
  m.distortion_left = left.distortion;
  m.distortion_right = right.distortion;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) m.R(i, j) = T_right_left.linear()(i, j);
    m.T[i] = T_right_left.translation()[i];
  }
  m.rms_px = std::sqrt(0.5 * (left.rms_px * left.rms_px + right.rms_px * right.rms_px));
  return ideal;
}

}  // namespace holdfast::sim
