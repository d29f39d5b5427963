// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/calibration_error.hpp"

#include <algorithm>
#include <cmath>

#include <opencv2/calib3d.hpp>

#include "tests/sim/or/ideal_calibration.hpp"

namespace holdfast::sim {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

Vector3d undistorted(const Vector2d& pixel, const cv::Matx33d& camera, const cv::Mat& distortion) {
  std::vector<cv::Point2d> in{{pixel.x(), pixel.y()}}, out;
  cv::undistortPoints(
      in, out, camera, distortion, cv::noArray(), cv::noArray(),
      cv::TermCriteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 100, 1e-13));
  return {out[0].x, out[0].y, 1};
}

Eigen::Matrix<double, 3, Eigen::Dynamic> as_matrix(const std::vector<Vector3d>& points) {
  Eigen::Matrix<double, 3, Eigen::Dynamic> m(3, static_cast<Eigen::Index>(points.size()));
  for (std::size_t i = 0; i < points.size(); ++i) m.col(static_cast<Eigen::Index>(i)) = points[i];
  return m;
}

}  // namespace

Vector3d triangulate(const registration::ZoomCalibration& model, const Vector2d& left_px,
                     const Vector2d& right_px, double* gap_mm) {
  Eigen::Matrix3d R;
  Vector3d t;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) R(i, j) = model.R(i, j);
    t[i] = model.T[i];
  }
  const Vector3d a = undistorted(left_px, model.camera_matrix_left, model.distortion_left);
  const Vector3d b =
      R.transpose() * undistorted(right_px, model.camera_matrix_right, model.distortion_right);
  const Vector3d o = -R.transpose() * t;  // the right camera's centre
  // Minimise |s a - (o + u b)|.
  Eigen::Matrix2d m;
  m << a.dot(a), -a.dot(b), -a.dot(b), b.dot(b);
  const Vector2d su = m.inverse() * Vector2d(a.dot(o), -b.dot(o));
  const Vector3d p = su[0] * a, q = o + su[1] * b;
  if (gap_mm != nullptr) *gap_mm = (p - q).norm();
  return 0.5 * (p + q);
}

Eigen::Isometry3d fit_rigid(const std::vector<Vector3d>& a, const std::vector<Vector3d>& b) {
  Eigen::Isometry3d T_b_a;
  T_b_a.matrix() = Eigen::umeyama(as_matrix(a), as_matrix(b), false);
  return T_b_a;
}

Eigen::Isometry3d frame_of(const registration::ZoomCalibration& model, const StereoOptics& optics) {
  const std::vector<Vector3d> truth = working_volume(optics);
  const Eigen::Isometry3d T_left_head = optics.T_head_left.inverse();
  const Eigen::Isometry3d T_right_head = optics.T_head_right.inverse();
  std::vector<Vector3d> found;
  for (const Vector3d& p : truth)
    found.push_back(triangulate(model, optics.left.project(T_left_head * p),
                                optics.right.project(T_right_head * p)));
  return fit_rigid(truth, found);
}

CalibrationError calibration_error(const registration::ZoomCalibration& model,
                                   const StereoOptics& optics) {
  const std::vector<Vector3d> truth = working_volume(optics);
  const Eigen::Isometry3d T_left_head = optics.T_head_left.inverse();
  const Eigen::Isometry3d T_right_head = optics.T_head_right.inverse();
  std::vector<Vector3d> found;
  double gap_sum = 0;
  for (const Vector3d& p : truth) {
    double gap = 0;
    found.push_back(triangulate(model, optics.left.project(T_left_head * p),
                                optics.right.project(T_right_head * p), &gap));
    gap_sum += gap * gap;
  }
  const Eigen::Isometry3d T_truth_found = fit_rigid(found, truth);
  CalibrationError error;
  double sum = 0;
  for (std::size_t i = 0; i < truth.size(); ++i) {
    const double e = (T_truth_found * found[i] - truth[i]).norm();
    sum += e * e;
    error.non_rigid_max_mm = std::max(error.non_rigid_max_mm, e);
  }
  const auto n = static_cast<double>(truth.size());
  const Eigen::Matrix4d similarity = Eigen::umeyama(as_matrix(found), as_matrix(truth), true);
  error.zoom = optics.zoom;
  error.points = static_cast<int>(truth.size());
  error.non_rigid_rms_mm = std::sqrt(sum / n);
  error.scale = similarity.col(0).head<3>().norm();
  error.epipolar_rms_px = std::sqrt(gap_sum / n) * optics.left.focal_px() / optics.focus_mm;
  return error;
}

}  // namespace holdfast::sim
