// SPDX-License-Identifier: Apache-2.0
#include "perception/tie.hpp"

#include <cmath>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include "perception/tracker_rules.hpp"

namespace holdfast::perception {
namespace {

using Vector6d = Eigen::Matrix<double, 6, 1>;

Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

Matrix6d turned(const Matrix6d& covariance, const Eigen::Matrix3d& R) {
  Matrix6d B = Matrix6d::Zero();
  B.topLeftCorner<3, 3>() = B.bottomRightCorner<3, 3>() = R;
  return B * covariance * B.transpose();
}

/// What the covariance about the tied keyframe's pivot says about the first's.
Matrix6d about_first(const CheckedPose& since_tied, const Eigen::Isometry3d& T_tied_first,
                     const Eigen::Vector3d& p_pivot_tied_mm,
                     const Eigen::Vector3d& p_pivot_first_mm) {
  const Eigen::Vector3d by_mm = since_tied.T_camera_site * (T_tied_first * p_pivot_first_mm) -
                                since_tied.T_camera_site * p_pivot_tied_mm;
  return about_other_pivot(since_tied.covariance, by_mm);
}

}  // namespace

Matrix6d about_other_pivot(const Matrix6d& covariance, const Eigen::Vector3d& by_mm) {
  Matrix6d J = Matrix6d::Identity();
  J.topRightCorner<3, 3>() = -cross_matrix(by_mm);
  return J * covariance * J.transpose();
}

Matrix6d bound_of_sum(const Matrix6d& a, const Matrix6d& b) {
  const double size_a = a.topLeftCorner<3, 3>().trace(), size_b = b.topLeftCorner<3, 3>().trace();
  if (!(size_a > 0 && size_b > 0)) return a + b;
  const double k = std::sqrt(size_b / size_a);
  return (1 + k) * a + (1 + 1 / k) * b;
}

CheckedPose through(const Tie& tie, const CheckedPose& since_tied,
                    const Eigen::Vector3d& p_pivot_tied_mm,
                    const Eigen::Vector3d& p_pivot_first_mm) {
  CheckedPose out;
  out.T_camera_site = since_tied.T_camera_site * tie.T_tied_first;
  out.covariance =
      bound_of_sum(about_first(since_tied, tie.T_tied_first, p_pivot_tied_mm, p_pivot_first_mm),
                   turned(tie.covariance, since_tied.T_camera_site.linear()));
  return out;
}

Tie tie_between(const CheckedPose& since_tied, const CheckedPose& since_first,
                const Eigen::Vector3d& p_pivot_tied_mm, const Eigen::Vector3d& p_pivot_first_mm) {
  Tie tie;
  tie.T_tied_first = since_tied.T_camera_site.inverse(Eigen::Isometry) * since_first.T_camera_site;
  const Matrix6d in_camera =
      bound_of_sum(about_first(since_tied, tie.T_tied_first, p_pivot_tied_mm, p_pivot_first_mm),
                   since_first.covariance);
  tie.covariance = turned(in_camera, since_tied.T_camera_site.linear().transpose());
  return tie;
}

PoseDifference between(const CheckedPose& a, const CheckedPose& b,
                       const Eigen::Vector3d& p_pivot_first_mm) {
  PoseDifference out;
  out.um = displacement_um(a.T_camera_site, b.T_camera_site, p_pivot_first_mm);
  const Eigen::AngleAxisd turn(a.T_camera_site.linear() * b.T_camera_site.linear().transpose());
  Vector6d d;
  d << a.T_camera_site * p_pivot_first_mm - b.T_camera_site * p_pivot_first_mm,
      turn.angle() * turn.axis();
  const Matrix6d C = bound_of_sum(a.covariance, b.covariance);
  const Vector6d scale = C.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  const Matrix6d S = scale.asDiagonal() * C * scale.asDiagonal();
  const Vector6d n = scale.asDiagonal() * d;
  out.sigma = std::sqrt(std::max(0.0, n.dot(S.ldlt().solve(n))));
  return out;
}

double sigma_um(const Matrix6d& covariance) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> solver(covariance.topLeftCorner<2, 2>(),
                                                              Eigen::EigenvaluesOnly);
  return 1000 * std::sqrt(std::max(0.0, solver.eigenvalues().maxCoeff()));
}

double rotation_sigma_rad(const Matrix6d& covariance) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(covariance.bottomRightCorner<3, 3>(),
                                                              Eigen::EigenvaluesOnly);
  return std::sqrt(std::max(0.0, solver.eigenvalues().maxCoeff()));
}

}  // namespace holdfast::perception
