// SPDX-License-Identifier: Apache-2.0
#include "registration/triangulation.hpp"

#include <cmath>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <opencv2/calib3d.hpp>
#include <opencv2/core/eigen.hpp>

namespace holdfast::registration {
namespace {

/// Gauss-Newton from the linear solution; the error is in pixels, as the noise is.
Eigen::Vector3d intersect(const Eigen::Vector2d& left, const Eigen::Vector2d& right,
                          const Eigen::Matrix3d& R, const Eigen::Vector3d& T, double f_left,
                          double f_right) {
  Eigen::Matrix<double, 4, 3> A;
  Eigen::Vector4d b;
  A.row(0) << 1, 0, -left.x();
  A.row(1) << 0, 1, -left.y();
  A.row(2) = R.row(0) - right.x() * R.row(2);
  A.row(3) = R.row(1) - right.y() * R.row(2);
  b << 0, 0, right.x() * T.z() - T.x(), right.y() * T.z() - T.y();
  Eigen::Vector3d p = (A.transpose() * A).ldlt().solve(A.transpose() * b);
  for (int i = 0; i < 3; ++i) {
    const Eigen::Vector3d q = R * p + T;
    Eigen::Matrix<double, 4, 3> J;
    Eigen::Vector4d r;
    Eigen::Matrix<double, 2, 3> d;
    d << 1 / p.z(), 0, -p.x() / (p.z() * p.z()), 0, 1 / p.z(), -p.y() / (p.z() * p.z());
    J.topRows<2>() = f_left * d;
    d << 1 / q.z(), 0, -q.x() / (q.z() * q.z()), 0, 1 / q.z(), -q.y() / (q.z() * q.z());
    J.bottomRows<2>() = f_right * d * R;
    r.head<2>() = f_left * (p.head<2>() / p.z() - left);
    r.tail<2>() = f_right * (q.head<2>() / q.z() - right);
    p -= (J.transpose() * J).ldlt().solve(J.transpose() * r);
  }
  return p;
}

}  // namespace

std::vector<Eigen::Vector2d> rays(const std::vector<cv::Point2d>& pixels,
                                  const cv::Matx33d& camera_matrix, const cv::Mat& distortion) {
  std::vector<Eigen::Vector2d> result;
  if (pixels.empty()) return result;
  std::vector<cv::Point2d> normalised;
  const cv::TermCriteria until(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 40, 1e-7);
  cv::undistortPoints(pixels, normalised, camera_matrix, distortion, cv::noArray(), cv::noArray(),
                      until);
  for (const cv::Point2d& ray : normalised) result.emplace_back(ray.x, ray.y);
  return result;
}

std::vector<TriangulatedPoint> triangulate(const std::vector<cv::Point2d>& left,
                                           const std::vector<cv::Point2d>& right,
                                           const ZoomCalibration& zoom) {
  const auto rays_left = rays(left, zoom.camera_matrix_left, zoom.distortion_left);
  const auto rays_right = rays(right, zoom.camera_matrix_right, zoom.distortion_right);
  Eigen::Matrix3d R, skew;
  cv::cv2eigen(zoom.R, R);
  const Eigen::Vector3d T(zoom.T[0], zoom.T[1], zoom.T[2]);
  skew << 0, -T.z(), T.y(), T.z(), 0, -T.x(), -T.y(), T.x(), 0;
  const Eigen::Matrix3d essential = skew * R;
  const auto focal = [](const cv::Matx33d& K) { return 0.5 * (K(0, 0) + K(1, 1)); };
  const double f_left = focal(zoom.camera_matrix_left), f_right = focal(zoom.camera_matrix_right);
  std::vector<TriangulatedPoint> points;
  for (std::size_t i = 0; i < rays_left.size(); ++i) {
    const Eigen::Vector3d line = essential * rays_left[i].homogeneous();
    points.push_back(
        {intersect(rays_left[i], rays_right[i], R, T, f_left, f_right),
         f_right * std::abs(line.dot(rays_right[i].homogeneous())) / line.head<2>().norm()});
  }
  return points;
}

Eigen::Isometry3d rigid_fit(const std::vector<Eigen::Vector3d>& from,
                            const std::vector<Eigen::Vector3d>& to) {
  const auto n = static_cast<Eigen::Index>(from.size());
  Eigen::Matrix3Xd a(3, n), b(3, n);
  for (Eigen::Index i = 0; i < n; ++i) {
    a.col(i) = from[static_cast<std::size_t>(i)];
    b.col(i) = to[static_cast<std::size_t>(i)];
  }
  return Eigen::Isometry3d(Eigen::umeyama(a, b, false));
}

Eigen::Matrix<double, 6, 1> triangulated_pose(const std::vector<cv::Point2d>& left,
                                              const std::vector<cv::Point2d>& right,
                                              const std::vector<Eigen::Vector3d>& points_mm,
                                              const ZoomCalibration& zoom) {
  std::vector<Eigen::Vector3d> seen;
  for (const TriangulatedPoint& point : triangulate(left, right, zoom))
    seen.push_back(point.p_camera_mm);
  const Eigen::Isometry3d T_camera_body = rigid_fit(points_mm, seen);
  const Eigen::AngleAxisd turn(T_camera_body.linear());
  Eigen::Matrix<double, 6, 1> pose;
  pose << turn.angle() * turn.axis(), T_camera_body.translation();
  return pose;
}

double rigid_residual_mm(const std::vector<Eigen::Vector3d>& from,
                         const std::vector<Eigen::Vector3d>& to) {
  const Eigen::Isometry3d T_to_from = rigid_fit(from, to);
  double squares = 0;
  for (std::size_t i = 0; i < from.size(); ++i)
    squares += (T_to_from * from[i] - to[i]).squaredNorm();
  return std::sqrt(squares / static_cast<double>(from.size()));
}

}  // namespace holdfast::registration
