// SPDX-License-Identifier: Apache-2.0
#include "perception/pose_fit.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <limits>
#include <random>

#include <Eigen/Cholesky>

namespace holdfast::perception {
namespace {

using Vector6d = Eigen::Matrix<double, 6, 1>;
using Jacobian = Eigen::Matrix<double, 2, 6>;

constexpr double kTukey = 4.685;            // 95 % efficiency for a normal distribution
constexpr double kRayleighMedian = 1.1774;  // median length of a 2-D normal error of unit sigma
constexpr double kSigmaFloorPx = 0.005;
constexpr double kConfidence = 0.9999;

/// Exp(r)(T p - T pivot) + T pivot + t: the parametrisation of MotionEstimate::covariance.
Eigen::Isometry3d moved(const Eigen::Isometry3d& T_camera_site, const Eigen::Vector3d& pivot_site,
                        const Vector6d& step) {
  const Eigen::Vector3d r = step.tail<3>();
  const double angle = r.norm();
  const Eigen::Matrix3d R = angle > 0 ? Eigen::AngleAxisd(angle, r / angle).toRotationMatrix()
                                      : Eigen::Matrix3d(Eigen::Matrix3d::Identity());
  const Eigen::Vector3d pivot_camera = T_camera_site * pivot_site;
  Eigen::Isometry3d out;
  out.linear() = Eigen::Quaterniond(R * T_camera_site.linear()).normalized().toRotationMatrix();
  out.translation() = pivot_camera + step.head<3>() - out.linear() * pivot_site;
  return out;
}

/// Residual (predicted - seen, px) and its Jacobian; false behind the camera.
bool linearise(const Observation& o, const FitSetup& setup, const Eigen::Isometry3d& T,
               const Eigen::Vector3d& pivot_camera, Eigen::Vector2d& residual, Jacobian& J) {
  const Eigen::Vector3d p = T * o.p_site_mm;
  if (!(p.z() > 1e-6)) return false;
  const double iz = 1 / p.z(), f = setup.f_px;
  residual = f * iz * p.head<2>() - o.seen_px;
  Eigen::Matrix<double, 2, 3> d;
  d << f * iz, 0, -f * p.x() * iz * iz, 0, f * iz, -f * p.y() * iz * iz;
  const Eigen::Vector3d q = p - pivot_camera;
  Eigen::Matrix3d cross;  // d(Exp(r) q)/dr = -[q]x
  cross << 0, q.z(), -q.y(), -q.z(), 0, q.x(), q.y(), -q.x(), 0;
  J.leftCols<3>() = d;
  J.rightCols<3>() = d * cross;
  if (setup.freedom == Freedom::planar) J.middleCols<2>(3).setZero();
  return true;
}

struct Normal {
  Matrix6d hessian = Matrix6d::Zero();
  Vector6d gradient = Vector6d::Zero();
};

/// Inverse on the free directions, zero on the fixed; false when they are not determined.
bool invert(const Matrix6d& H, Freedom freedom, Matrix6d& inverse) {
  const Vector6d scale = H.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  Matrix6d S = scale.asDiagonal() * H * scale.asDiagonal();
  if (freedom == Freedom::planar) {
    S.row(3).setZero();
    S.row(4).setZero();
    S.col(3).setZero();
    S.col(4).setZero();
    S(3, 3) = S(4, 4) = 1;
  }
  const Eigen::LDLT<Matrix6d> ldlt(S);
  if (ldlt.info() != Eigen::Success || !(ldlt.vectorD().minCoeff() > 1e-9)) return false;
  inverse = scale.asDiagonal() * ldlt.solve(Matrix6d::Identity()) * scale.asDiagonal();
  if (freedom == Freedom::planar) {
    inverse.row(3).setZero();
    inverse.row(4).setZero();
    inverse.col(3).setZero();
    inverse.col(4).setZero();
  }
  return inverse.allFinite();
}

double robust_sigma_px(const Observations& observations, const Eigen::Isometry3d& T, double f_px,
                       double limit_px, std::vector<double>& scratch) {
  scratch.clear();
  for (const Observation& o : observations) {
    const double e = reprojection_error_px(o, T, f_px);
    if (e <= limit_px) scratch.push_back(e);
  }
  if (scratch.size() < 4) return limit_px / kTukey;
  const auto middle = scratch.begin() + static_cast<std::ptrdiff_t>(scratch.size() / 2);
  std::nth_element(scratch.begin(), middle, scratch.end());
  return std::max(*middle / kRayleighMedian, kSigmaFloorPx);
}

Normal accumulate(const Observations& observations, const FitSetup& setup,
                  const Eigen::Isometry3d& T, double cut_px) {
  Normal normal;
  const Eigen::Vector3d pivot_camera = T * setup.p_pivot_site_mm;
  Eigen::Vector2d residual;
  Jacobian J;
  for (const Observation& o : observations) {
    if (!linearise(o, setup, T, pivot_camera, residual, J)) continue;
    const double u = residual.squaredNorm() / (cut_px * cut_px);
    if (!(u < 1)) continue;
    const double weight = (1 - u) * (1 - u);
    normal.hessian.noalias() += weight * J.transpose() * J;
    normal.gradient.noalias() -= weight * J.transpose() * residual;
  }
  return normal;
}

/// Plain Gauss-Newton over a few observations, from T: the minimal solver of the samples.
bool solve_sample(const Observations& sample, const FitSetup& setup, Eigen::Isometry3d& T) {
  for (int i = 0; i < 4; ++i) {
    const Normal normal = accumulate(sample, setup, T, 1e6);
    Matrix6d inverse;
    if (!invert(normal.hessian, setup.freedom, inverse)) return false;
    const Vector6d step = inverse * normal.gradient;
    if (!step.allFinite() || step.tail<3>().norm() > 1) return false;
    T = moved(T, setup.p_pivot_site_mm, step);
  }
  return true;
}

/// The planar motion that two observations determine: x' = s R x + t in normalised coordinates.
bool planar_from_two(const Observation& a, const Observation& b, const FitSetup& setup,
                     Eigen::Isometry3d& T) {
  using C = std::complex<double>;
  const auto ray = [](const Eigen::Vector3d& p) { return C(p.x() / p.z(), p.y() / p.z()); };
  const C x0 = ray(a.p_site_mm), x1 = ray(b.p_site_mm);
  const C y0 = C(a.seen_px.x(), a.seen_px.y()) / setup.f_px;
  const C y1 = C(b.seen_px.x(), b.seen_px.y()) / setup.f_px;
  if (std::abs(x1 - x0) * setup.f_px < 20) return false;  // too near each other to say anything
  const C m = (y1 - y0) / (x1 - x0), t = y0 - m * x0;
  const double s = std::abs(m);
  if (!(s > 0.3 && s < 3)) return false;
  const double z_site = setup.p_pivot_site_mm.z(), z_now = z_site / s;
  T.linear() = Eigen::AngleAxisd(std::arg(m), Eigen::Vector3d::UnitZ()).toRotationMatrix();
  T.translation() << t.real() * z_now, t.imag() * z_now, z_now - z_site;
  return true;
}

int count_inliers(const Observations& observations, const Eigen::Isometry3d& T, double f_px,
                  double threshold_px) {
  int n = 0;
  const Eigen::Matrix3d R = f_px * T.linear();
  const Eigen::Vector3d t = f_px * T.translation();
  const double limit = threshold_px * threshold_px;
  for (const Observation& o : observations) {
    const Eigen::Vector3d p = R * o.p_site_mm + t;  // f * p_camera
    if (!(p.z() > 0)) continue;
    n += (p.head<2>() * (f_px / p.z()) - o.seen_px).squaredNorm() <= limit ? 1 : 0;
  }
  return n;
}

std::vector<int> inlier_indices(const Observations& observations, const Eigen::Isometry3d& T,
                                double f_px, double threshold_px) {
  std::vector<int> inliers;
  for (std::size_t i = 0; i < observations.size(); ++i)
    if (reprojection_error_px(observations[i], T, f_px) <= threshold_px)
      inliers.push_back(static_cast<int>(i));
  return inliers;
}

int iterations_needed(double inlier_share, int sample_size, int at_most) {
  const double all_in = std::pow(inlier_share, sample_size);
  if (all_in <= 1e-9) return at_most;
  if (all_in >= 1 - 1e-9) return 1;
  return std::min<int>(
      at_most, static_cast<int>(std::ceil(std::log(1 - kConfidence) / std::log(1 - all_in))));
}

/// RANSAC: `solve` makes a pose of the observations drawn, or says false.
template <int kSampleSize, typename Solve>
std::optional<Eigen::Isometry3d> sample_consensus(const Observations& observations,
                                                  const ConsensusParameters& parameters,
                                                  double threshold_px, double f_px, Solve solve) {
  const auto n = observations.size();
  if (n < static_cast<std::size_t>(std::max(parameters.inliers_min, kSampleSize)))
    return std::nullopt;
  std::minstd_rand random(parameters.seed);
  std::optional<Eigen::Isometry3d> best;
  int most = parameters.inliers_min - 1, needed = parameters.iterations;
  for (int iteration = 0; iteration < needed; ++iteration) {
    Observations sample;
    for (int k = 0; k < kSampleSize; ++k)
      sample.push_back(observations[random() % n]);  // a point drawn twice fails to solve
    Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
    if (!solve(sample, T)) continue;
    const int inliers = count_inliers(observations, T, f_px, threshold_px);
    if (inliers <= most) continue;
    most = inliers;
    best = T;
    needed = iterations_needed(static_cast<double>(inliers) / static_cast<double>(n), kSampleSize,
                               parameters.iterations);
  }
  return best;
}

}  // namespace

double reprojection_error_px(const Observation& o, const Eigen::Isometry3d& T_camera_site,
                             double f_px) {
  const Eigen::Vector3d p = T_camera_site * o.p_site_mm;
  if (!(p.z() > 1e-6)) return std::numeric_limits<double>::infinity();
  return (f_px / p.z() * p.head<2>() - o.seen_px).norm();
}

std::optional<PoseFit> find_consensus(const Observations& observations, const FitSetup& setup,
                                      const ConsensusParameters& parameters) {
  const bool is_rigid = setup.freedom == Freedom::rigid;
  const double wide_px = parameters.threshold_px + (is_rigid ? parameters.parallax_px : 0);
  auto T = sample_consensus<2>(observations, parameters, wide_px, setup.f_px,
                               [&](const Observations& s, Eigen::Isometry3d& out) {
                                 return planar_from_two(s[0], s[1], setup, out);
                               });
  if (T && is_rigid) {
    Observations near;
    for (const int i : inlier_indices(observations, *T, setup.f_px, wide_px))
      near.push_back(observations[static_cast<std::size_t>(i)]);
    const Eigen::Isometry3d T_planar = *T;
    T = sample_consensus<4>(near, parameters, parameters.threshold_px, setup.f_px,
                            [&](const Observations& s, Eigen::Isometry3d& out) {
                              out = T_planar;
                              return solve_sample(s, setup, out);
                            });
  }
  if (!T) return std::nullopt;
  auto fit = refine(observations, setup, *T, parameters.threshold_px);
  if (!fit || static_cast<int>(fit->inliers.size()) < parameters.inliers_min) return std::nullopt;
  return fit;
}

std::optional<PoseFit> refine(const Observations& observations, const FitSetup& setup,
                              const Eigen::Isometry3d& T_start, double threshold_px) {
  constexpr int kIterations = 10;
  PoseFit fit;
  fit.T_camera_site = T_start;
  std::vector<double> scratch;
  double cut_px = 2 * threshold_px;  // wide at first, then as the residuals say
  for (int i = 0; i < kIterations; ++i) {
    const Normal normal = accumulate(observations, setup, fit.T_camera_site, cut_px);
    Matrix6d inverse;
    if (!invert(normal.hessian, setup.freedom, inverse)) return std::nullopt;
    const Vector6d step = inverse * normal.gradient;
    if (!step.allFinite() || step.tail<3>().norm() > 1) return std::nullopt;
    fit.T_camera_site = moved(fit.T_camera_site, setup.p_pivot_site_mm, step);
    fit.sigma_px =
        robust_sigma_px(observations, fit.T_camera_site, setup.f_px, 2 * threshold_px, scratch);
    cut_px = std::min(2 * threshold_px, kTukey * fit.sigma_px);
    const double moved_px = step.head<3>().norm() * setup.f_px / setup.p_pivot_site_mm.z() +
                            step.tail<3>().norm() * 1000;
    if (i > 1 && moved_px < 1e-4) break;
  }
  const Normal normal = accumulate(observations, setup, fit.T_camera_site, cut_px);
  if (!invert(normal.hessian, setup.freedom, fit.unit_covariance)) return std::nullopt;
  fit.inliers = inlier_indices(observations, fit.T_camera_site, setup.f_px, threshold_px);
  double squares = 0;
  for (const int i : fit.inliers) {
    const double e = reprojection_error_px(observations[static_cast<std::size_t>(i)],
                                           fit.T_camera_site, setup.f_px);
    squares += e * e;
  }
  if (fit.inliers.empty()) return std::nullopt;
  fit.rms_px = std::sqrt(squares / static_cast<double>(fit.inliers.size()));
  return fit;
}

}  // namespace holdfast::perception
