// SPDX-License-Identifier: Apache-2.0
#include "registration/rigid_fit.hpp"

#include <cmath>
#include <limits>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/SVD>
#include <boost/math/distributions/chi_squared.hpp>
#include <boost/math/distributions/fisher_f.hpp>

namespace holdfast::registration {
namespace {

constexpr int kIterationsMax = 50;
constexpr double kStepMinMm = 1e-10;  // a rotation's step counts as mm at 100 mm
constexpr double kRegion = 0.95;      // the region whose coverage the covariance is to keep
// Points whose spread about their best line is below this part of their spread along it are a line:
// the rotation about it then carries a hundred times the others' error.
constexpr double kLineRatioMin = 0.01;

Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

bool is_a_line(const Eigen::Matrix3Xd& points) {
  const Eigen::Matrix3Xd centred = points.colwise() - points.rowwise().mean();
  const Eigen::Vector3d spread =
      Eigen::JacobiSVD<Eigen::MatrixXd>{Eigen::MatrixXd{centred}}.singularValues().head<3>();
  return !(spread(1) > kLineRatioMin * spread(0));
}

/// The stacked problem: residual y = p_camera - (R p_ct + t), its covariance, its Jacobian.
struct Problem {
  const FiducialSet& fiducials;
  Eigen::Matrix3Xd p_camera, p_ct;

  explicit Problem(const FiducialSet& set) : fiducials(set) {
    const auto n = static_cast<Eigen::Index>(set.pairs.size());
    p_camera.resize(3, n);
    p_ct.resize(3, n);
    for (Eigen::Index i = 0; i < n; ++i) {
      const FiducialPair& pair = set.pairs[static_cast<std::size_t>(i)];
      p_camera.col(i) = pair.p_camera_mm;
      p_ct.col(i) = pair.p_ct_mm;
    }
  }
  [[nodiscard]] Eigen::Index count() const { return p_ct.cols(); }

  [[nodiscard]] Eigen::VectorXd residual(const Eigen::Isometry3d& T) const {
    Eigen::Matrix3Xd y(3, count());
    for (Eigen::Index i = 0; i < count(); ++i) y.col(i) = p_camera.col(i) - T * p_ct.col(i);
    return Eigen::Map<Eigen::VectorXd>{y.data(), y.size()};
  }

  [[nodiscard]] Eigen::MatrixXd jacobian(const Eigen::Isometry3d& T) const {
    Eigen::MatrixXd J(3 * count(), 6);
    for (Eigen::Index i = 0; i < count(); ++i)
      J.middleRows<3>(3 * i) = point_jacobian(T, p_ct.col(i));
    return J;
  }
};

bool is_usable(const FiducialSet& set) {
  const auto n = static_cast<Eigen::Index>(3 * set.pairs.size());
  const Eigen::MatrixXd& joint = set.joint_covariance_camera_mm2;
  if (joint.size() != 0 && (joint.rows() != n || joint.cols() != n || !joint.allFinite()))
    return false;
  for (const FiducialPair& pair : set.pairs)
    if (!pair.p_ct_mm.allFinite() || !pair.p_camera_mm.allFinite() ||
        !pair.covariance_ct_mm2.allFinite() || !pair.covariance_camera_mm2.allFinite())
      return false;
  return true;
}

/// Gauss-Newton under the covariance at hand; false when a covariance is not positive definite or
/// the steps do not end.
bool refine(const Problem& problem, RigidFit& fit) {
  for (int i = 0; i < kIterationsMax; ++i) {
    const Eigen::LLT<Eigen::MatrixXd> noise{fiducial_noise(problem.fiducials, fit.T_camera_ct)};
    if (noise.info() != Eigen::Success) return false;
    const Eigen::MatrixXd J = noise.matrixL().solve(problem.jacobian(fit.T_camera_ct));
    const Eigen::VectorXd y = noise.matrixL().solve(problem.residual(fit.T_camera_ct));
    const Eigen::LDLT<Matrix6d> normal{Matrix6d{J.transpose() * J}};
    const Vector6d step = normal.solve(J.transpose() * y);
    if (!step.allFinite()) return false;
    fit.T_camera_ct = moved(fit.T_camera_ct, step);
    fit.covariance = normal.solve(Matrix6d::Identity());
    fit.chi_squared = y.squaredNorm();
    if (step.head<3>().norm() + 100 * step.tail<3>().norm() < kStepMinMm) return true;
  }
  return false;
}

void judge_by_residuals(RigidFit& fit) {
  namespace math = boost::math;
  const double dof = fit.degrees_of_freedom;
  const double fisher = 3 * math::quantile(math::fisher_f{3, dof}, kRegion);
  const double gauss = math::quantile(math::chi_squared{3}, kRegion);
  fit.covariance *= fit.chi_squared / dof * fisher / gauss;
  fit.chi_squared = fit.p_value = std::numeric_limits<double>::quiet_NaN();
}

}  // namespace

Eigen::Isometry3d horn(const Eigen::Matrix3Xd& p_camera, const Eigen::Matrix3Xd& p_ct) {
  const Eigen::Vector3d mean_camera = p_camera.rowwise().mean(), mean_ct = p_ct.rowwise().mean();
  const Eigen::Matrix3d S =
      (p_ct.colwise() - mean_ct) * (p_camera.colwise() - mean_camera).transpose();
  // Horn's symmetric 4x4 matrix; its largest eigenvector is the unit quaternion (w, x, y, z).
  const Eigen::Vector3d delta{S(1, 2) - S(2, 1), S(2, 0) - S(0, 2), S(0, 1) - S(1, 0)};
  Eigen::Matrix4d N;
  N(0, 0) = S.trace();
  N.block<1, 3>(0, 1) = delta.transpose();
  N.block<3, 1>(1, 0) = delta;
  N.block<3, 3>(1, 1) = S + S.transpose() - S.trace() * Eigen::Matrix3d::Identity();
  const Eigen::Vector4d q = Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d>{N}.eigenvectors().col(3);
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = Eigen::Quaterniond{q(0), q(1), q(2), q(3)}.normalized().toRotationMatrix();
  T.translation() = mean_camera - T.linear() * mean_ct;
  return T;
}

Eigen::Isometry3d moved(const Eigen::Isometry3d& T_camera_ct, const Vector6d& step) {
  Eigen::Isometry3d result = T_camera_ct;
  const double angle_rad = step.tail<3>().norm();
  if (angle_rad > 0)
    result.linear() = Eigen::AngleAxisd{angle_rad, step.tail<3>() / angle_rad}.toRotationMatrix() *
                      T_camera_ct.linear();
  result.translation() += step.head<3>();
  return result;
}

Eigen::Matrix<double, 3, 6> point_jacobian(const Eigen::Isometry3d& T_camera_ct,
                                           const Eigen::Vector3d& p_ct_mm) {
  Eigen::Matrix<double, 3, 6> J;
  J.leftCols<3>().setIdentity();
  J.rightCols<3>() = -cross_matrix(T_camera_ct.linear() * p_ct_mm);
  return J;
}

Eigen::Matrix3d target_covariance(const Eigen::Isometry3d& T_camera_ct, const Matrix6d& covariance,
                                  const Eigen::Vector3d& p_target_ct_mm) {
  const Eigen::Matrix<double, 3, 6> J = point_jacobian(T_camera_ct, p_target_ct_mm);
  return J * covariance * J.transpose();
}

Eigen::MatrixXd fiducial_noise(const FiducialSet& fiducials, const Eigen::Isometry3d& T_camera_ct) {
  const auto n = static_cast<Eigen::Index>(3 * fiducials.pairs.size());
  if (!fiducials.has_covariances) return Eigen::MatrixXd::Identity(n, n);
  const bool is_joint = fiducials.joint_covariance_camera_mm2.size() != 0;
  Eigen::MatrixXd covariance = Eigen::MatrixXd::Zero(n, n);
  if (is_joint) covariance = fiducials.joint_covariance_camera_mm2;
  const Eigen::Matrix3d& R = T_camera_ct.linear();
  for (Eigen::Index i = 0; 3 * i < n; ++i) {
    const FiducialPair& pair = fiducials.pairs[static_cast<std::size_t>(i)];
    auto block = covariance.block<3, 3>(3 * i, 3 * i);
    if (!is_joint) block += pair.covariance_camera_mm2;
    block += R * pair.covariance_ct_mm2 * R.transpose();
  }
  return covariance;
}

RigidFit fit_rigid(const FiducialSet& fiducials) {
  RigidFit fit;
  if (!is_usable(fiducials)) return fit;
  const auto n = static_cast<int>(fiducials.pairs.size());
  if (n < 3) {
    fit.status = FitStatus::too_few;
    return fit;
  }
  const Problem problem{fiducials};
  if (is_a_line(problem.p_ct) || is_a_line(problem.p_camera)) {
    fit.status = FitStatus::collinear;
    return fit;
  }
  fit.degrees_of_freedom = 3 * n - 6;
  fit.T_camera_ct = horn(problem.p_camera, problem.p_ct);
  if (!refine(problem, fit)) return fit;
  const Eigen::VectorXd residual = problem.residual(fit.T_camera_ct);
  fit.fre_mm = std::sqrt(residual.squaredNorm() / n);
  for (Eigen::Index i = 0; i < n; ++i)
    fit.residuals_mm.push_back(residual.segment<3>(3 * i).norm());
  if (fiducials.has_covariances)
    fit.p_value = boost::math::cdf(boost::math::complement(
        boost::math::chi_squared{static_cast<double>(fit.degrees_of_freedom)}, fit.chi_squared));
  else
    judge_by_residuals(fit);
  fit.status = FitStatus::fitted;
  return fit;
}

}  // namespace holdfast::registration
