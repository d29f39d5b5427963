// SPDX-License-Identifier: Apache-2.0
#include "registration/rigid_fit.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <boost/math/distributions/chi_squared.hpp>
#include <boost/math/distributions/fisher_f.hpp>

namespace holdfast::registration {
namespace {

constexpr int kIterationsMax = 300;
constexpr double kDecrementMin = 1e-12;  // of the squared length: a millionth of a sigma is left
constexpr double kCostRounding = 1e-9;   // of numbers of 200 mm known to a micrometre
constexpr double kDampingFirst = 1e-4, kDampingAtEnd = 1e-6;  // share of the information
constexpr double kRegion = 0.95;  // the region whose coverage the covariance is to keep
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
  const Eigen::Vector3d squares =  // of the spreads, the least first
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>{centred * centred.transpose(),
                                                     Eigen::EigenvaluesOnly}
          .eigenvalues();
  return !(squares(1) > kLineRatioMin * kLineRatioMin * squares(2));
}

/// The stacked problem: residual y = p_camera - (R p_ct + t), its covariance.
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

/// Half the squared Mahalanobis length of the residuals, and its derivatives by a step (dt, r) that
/// turns about `centre_mm`: r about the camera's origin would tie turn and shift together.
struct Quadratic {
  double cost = 0;
  Vector6d descent = Vector6d::Zero();  ///< minus the gradient
  Matrix6d information =
      Matrix6d::Zero();                   ///< J'WJ: Gauss-Newton's curvature, Fisher's information
  Matrix6d curvature = Matrix6d::Zero();  ///< with what the turn adds in second order: Newton's
};

Quadratic quadratic_at(const Problem& problem, const Eigen::LLT<Eigen::MatrixXd>& noise,
                       const Eigen::Isometry3d& T, const Eigen::Vector3d& centre_mm) {
  const Eigen::VectorXd y = problem.residual(T), w = noise.solve(y);
  Eigen::MatrixXd J(3 * problem.count(), 6);
  Quadratic q;
  for (Eigen::Index i = 0; i < problem.count(); ++i) {
    const Eigen::Vector3d arm = T * problem.p_ct.col(i) - centre_mm, pull = w.segment<3>(3 * i);
    J.middleRows<3>(3 * i) << Eigen::Matrix3d::Identity(), -cross_matrix(arm);
    // Exp(r)·arm = arm + r x arm + r x (r x arm) / 2 + ...: the last, along `pull`.
    q.curvature.bottomRightCorner<3, 3>() +=
        pull.dot(arm) * Eigen::Matrix3d::Identity() -
        0.5 * (pull * arm.transpose() + arm * pull.transpose());
  }
  q.cost = 0.5 * y.dot(w);
  q.descent = J.transpose() * w;
  q.information = J.transpose() * noise.solve(J);
  q.curvature += q.information;
  return q;
}

/// `T` after a step that turns about `centre_mm`.
Eigen::Isometry3d stepped(const Eigen::Isometry3d& T, const Vector6d& step,
                          const Eigen::Vector3d& centre_mm) {
  const double angle_rad = step.tail<3>().norm();
  const Eigen::Vector3d axis =
      angle_rad > 0 ? Eigen::Vector3d{step.tail<3>() / angle_rad} : Eigen::Vector3d::UnitX();
  return Eigen::Translation3d{centre_mm + step.head<3>()} * Eigen::AngleAxisd{angle_rad, axis} *
         Eigen::Translation3d{-centre_mm} * T;
}

/// From a step that turns about `centre_mm` to the same as RigidFit::covariance means it.
Matrix6d about_origin(const Eigen::Isometry3d& T, const Eigen::Vector3d& centre_mm) {
  Matrix6d A = Matrix6d::Identity();
  A.topRightCorner<3, 3>() = -cross_matrix(T.translation() - centre_mm);
  return A;
}

/// Newton's method with Levenberg's damping under the covariance at hand; false when a covariance
/// is not positive definite or no minimum is reached. Gauss-Newton would not do: where all points
/// may turn together far more than their distances may change, the curvature that it leaves out is
/// larger than what it keeps, and it circles the minimum for ever.
bool refine(const Problem& problem, RigidFit& fit) {
  const Eigen::Vector3d centre_mm = problem.p_camera.rowwise().mean();
  double damping = 0;
  for (int i = 0; i < kIterationsMax; ++i) {
    const Eigen::LLT<Eigen::MatrixXd> noise{fiducial_noise(problem.fiducials, fit.T_camera_ct)};
    if (noise.info() != Eigen::Success) return false;
    const Quadratic here = quadratic_at(problem, noise, fit.T_camera_ct, centre_mm);
    Matrix6d damped = here.curvature;
    damped.diagonal() += damping * here.information.diagonal();
    const Eigen::LLT<Matrix6d> normal{damped};
    const Vector6d step = normal.solve(here.descent);
    if (normal.info() == Eigen::Success && !step.allFinite()) return false;
    const bool is_end = normal.info() == Eigen::Success && here.descent.dot(step) < kDecrementMin &&
                        damping < kDampingAtEnd;
    const Eigen::Isometry3d next = normal.info() == Eigen::Success
                                       ? stepped(fit.T_camera_ct, step, centre_mm)
                                       : fit.T_camera_ct;
    if (is_end) {  // so near that this step's error is its square
      const Matrix6d A = about_origin(next, centre_mm);
      fit.covariance = A * here.information.llt().solve(Matrix6d::Identity()) * A.transpose();
      fit.chi_squared = 2 * here.cost;
      fit.T_camera_ct = next;
      return true;
    }
    const Eigen::VectorXd y = problem.residual(next);
    if (normal.info() == Eigen::Success &&
        0.5 * y.dot(noise.solve(y)) <= here.cost + kCostRounding * (1 + here.cost)) {
      fit.T_camera_ct = next;
      damping = damping > kDampingAtEnd ? 0.1 * damping : 0;
    } else {
      damping = std::max(10 * damping, kDampingFirst);
    }
  }
  return false;
}

/// What each camera point's error holds that is its own: 3x3 blocks on the diagonal, as large as
/// the joint covariance leaves room for in the proportions of each point's covariance given the
/// others. Rather too small: then more counts as common.
Eigen::MatrixXd own_covariance(const Eigen::MatrixXd& joint) {
  Eigen::MatrixXd own = Eigen::MatrixXd::Zero(joint.rows(), joint.cols());
  const Eigen::LLT<Eigen::MatrixXd> factor{joint};
  if (factor.info() != Eigen::Success) return own;
  const Eigen::MatrixXd inverse =
      factor.solve(Eigen::MatrixXd::Identity(joint.rows(), joint.cols()));
  for (Eigen::Index i = 0; i < joint.rows(); i += 3)
    own.block<3, 3>(i, i) = Eigen::Matrix3d{inverse.block<3, 3>(i, i)}.inverse();
  const Eigen::LLT<Eigen::MatrixXd> root{own};
  if (root.info() != Eigen::Success) return Eigen::MatrixXd::Zero(joint.rows(), joint.cols());
  const Eigen::MatrixXd half = root.matrixL().solve(joint);
  const Eigen::MatrixXd ratio = root.matrixL().solve(half.transpose());
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen{
      Eigen::MatrixXd{0.5 * (ratio + ratio.transpose())}, Eigen::EigenvaluesOnly};
  return std::clamp(eigen.eigenvalues()(0), 0.0, 1.0) * own;
}

/// The part of `fit.covariance` that comes from what the camera points' errors have in common.
Matrix6d common_covariance(const Problem& problem, const RigidFit& fit) {
  const Eigen::MatrixXd& joint = problem.fiducials.joint_covariance_camera_mm2;
  const Eigen::LLT<Eigen::MatrixXd> noise{fiducial_noise(problem.fiducials, fit.T_camera_ct)};
  Eigen::MatrixXd J(3 * problem.count(), 6);
  for (Eigen::Index i = 0; i < problem.count(); ++i)
    J.middleRows<3>(3 * i) = point_jacobian(fit.T_camera_ct, problem.p_ct.col(i));
  // How far each point's error moves the fit: (J'WJ)^-1 J'W.
  const Eigen::MatrixXd gain = fit.covariance * noise.solve(J).transpose();
  return gain * (joint - own_covariance(joint)) * gain.transpose();
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
  if (!refine(problem, fit) || !fit.covariance.allFinite()) return fit;
  const Eigen::VectorXd residual = problem.residual(fit.T_camera_ct);
  fit.fre_mm = std::sqrt(residual.squaredNorm() / n);
  for (Eigen::Index i = 0; i < n; ++i)
    fit.residuals_mm.push_back(residual.segment<3>(3 * i).norm());
  if (fiducials.has_covariances)
    fit.p_value = boost::math::cdf(boost::math::complement(
        boost::math::chi_squared{static_cast<double>(fit.degrees_of_freedom)}, fit.chi_squared));
  else
    judge_by_residuals(fit);
  if (fiducials.has_covariances && fiducials.joint_covariance_camera_mm2.size() != 0)
    fit.common_covariance = common_covariance(problem, fit);
  fit.status = FitStatus::fitted;
  return fit;
}

}  // namespace holdfast::registration
