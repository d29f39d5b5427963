// SPDX-License-Identifier: Apache-2.0
#include "registration/surface_fit.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <random>
#include <tuple>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <boost/math/distributions/chi_squared.hpp>

namespace holdfast::registration {
namespace {

using Vector6d = Eigen::Matrix<double, 6, 1>;

constexpr int kIterationsMax = 60;
constexpr double kStepMinMm = 1e-5;
constexpr double kGate = 4;  // robust standard deviations beyond which a point does not vote
constexpr double kMadToSigma = 1.4826;

/// One point that lies on the CT surface: residual r = n·(p - q), with d(n·q) = h·step.
struct Contact {
  double residual_mm;
  Vector6d h;
  Eigen::Vector3d q_camera_mm;
};
using Cell = std::tuple<int, int, int>;

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

std::vector<Eigen::Vector3d> drawn(const std::vector<Eigen::Vector3d>& points,
                                   const SurfaceFitOptions& options) {
  std::vector<Eigen::Vector3d> result = points;
  if (options.points >= result.size()) return result;
  std::mt19937_64 random{options.seed};
  for (std::size_t i = 0; i < options.points; ++i)
    std::swap(result[i], result[i + random() % (result.size() - i)]);
  result.resize(options.points);
  return result;
}

std::vector<Contact> contacts(const std::vector<Eigen::Vector3d>& p_camera_mm,
                              const TriangleTree& ct, const Eigen::Isometry3d& T_camera_ct,
                              double within_mm) {
  const Eigen::Isometry3d T_ct_camera = T_camera_ct.inverse();
  std::vector<Contact> result;
  for (const Eigen::Vector3d& p : p_camera_mm) {
    const ClosestPoint closest = ct.closest(T_ct_camera * p, within_mm);
    if (!closest.is_found || closest.is_on_rim) continue;
    const Eigen::Vector3d n = T_camera_ct.linear() * ct.normal(closest.triangle);
    const Eigen::Vector3d q = T_camera_ct * closest.p_mm;
    result.push_back({n.dot(p - q), point_jacobian(T_camera_ct, closest.p_mm).transpose() * n, q});
  }
  return result;
}

/// Leaves out what is too far from the rest.
void gate(std::vector<Contact>& contacts) {
  std::vector<double> magnitudes;
  for (const Contact& c : contacts) magnitudes.push_back(std::abs(c.residual_mm));
  const double limit = kGate * kMadToSigma * median(magnitudes) + 1e-9;
  std::erase_if(contacts, [limit](const Contact& c) { return std::abs(c.residual_mm) > limit; });
}

struct Region {
  double count = 0, sum_residual = 0;
  Vector6d sum_h = Vector6d::Zero(), sum_hr = Vector6d::Zero();
  Matrix6d sum_hh = Matrix6d::Zero();
  std::vector<double> residuals;
};

std::map<Cell, Region> regions(const std::vector<Contact>& contacts, double size_mm) {
  std::map<Cell, Region> result;
  for (const Contact& c : contacts) {
    const Eigen::Vector3i cell = (c.q_camera_mm / size_mm).array().floor().cast<int>();
    Region& region = result[{cell.x(), cell.y(), cell.z()}];
    region.count += 1;
    region.sum_residual += c.residual_mm;
    region.sum_h += c.h;
    region.sum_hr += c.h * c.residual_mm;
    region.sum_hh += c.h * c.h.transpose();
    region.residuals.push_back(c.residual_mm);
  }
  return result;
}

/// The two error scales from the residuals: within regions and between them.
void measure_noise(const std::map<Cell, Region>& regions, double regional_min_mm, SurfaceFit& fit) {
  constexpr double kPointsMin = 5;
  std::vector<double> within;
  double between = 0, sampling = 0, used = 0;
  for (const auto& [cell, region] : regions) {
    if (region.count < kPointsMin) continue;
    const double mean = region.sum_residual / region.count;
    for (const double r : region.residuals) within.push_back(std::abs(r - mean));
    between += mean * mean;
    sampling += 1 / region.count;
    used += 1;
  }
  constexpr double kNoiseFloorMm = 1e-3;
  fit.noise_mm =
      within.empty() ? kNoiseFloorMm : std::max(kNoiseFloorMm, kMadToSigma * median(within));
  // Six numbers of the regions' means were spent on the fit.
  const double excess =
      used > 6 ? between / (used - 6) - fit.noise_mm * fit.noise_mm * sampling / used : 0;
  fit.regional_mm = std::max(regional_min_mm, std::sqrt(std::max(0.0, excess)));
}

/// Adds each region's information: noise of each point and one error that all its points share
/// (Woodbury: (s^2 I + g^2 11')^-1 = (I - g^2/(s^2 + m g^2) 11')/s^2).
void add_information(const std::map<Cell, Region>& regions, const SurfaceFit& fit,
                     Matrix6d& information, Vector6d& gradient) {
  const double s2 = fit.noise_mm * fit.noise_mm, g2 = fit.regional_mm * fit.regional_mm;
  for (const auto& [cell, region] : regions) {
    const double shared = g2 / (s2 + region.count * g2);
    information += (region.sum_hh - shared * region.sum_h * region.sum_h.transpose()) / s2;
    gradient += (region.sum_hr - shared * region.sum_h * region.sum_residual) / s2;
  }
}

Eigen::Isometry3d moved(const Eigen::Isometry3d& T, const Vector6d& step) {
  Eigen::Isometry3d result = T;
  const double angle_rad = step.tail<3>().norm();
  if (angle_rad > 0)
    result.linear() =
        Eigen::AngleAxisd{angle_rad, step.tail<3>() / angle_rad}.toRotationMatrix() * T.linear();
  result.translation() += step.head<3>();
  return result;
}

/// The step (dt, r) that leads from `from` to `to`.
Vector6d difference(const Eigen::Isometry3d& from, const Eigen::Isometry3d& to) {
  const Eigen::AngleAxisd turn{Eigen::Matrix3d{to.linear() * from.linear().transpose()}};
  Vector6d step;
  step << to.translation() - from.translation(), turn.angle() * turn.axis();
  return step;
}

/// Both estimates of one thing, the later one containing the earlier: the covariance of their
/// difference is the difference of their covariances. Directions to which the surface adds nothing
/// say nothing.
double p_value_of_shift(const Vector6d& shift, const Matrix6d& before, const Matrix6d& after) {
  // Scaled to comparable units first: mm, and mm at 100 mm.
  Vector6d scale;
  scale << 1, 1, 1, 100, 100, 100;
  const Matrix6d covariance = scale.asDiagonal() * (before - after) * scale.asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Matrix6d> eigen{covariance};
  const Vector6d along = eigen.eigenvectors().transpose() * scale.cwiseProduct(shift);
  double squared = 0;
  int dof = 0;
  for (int i = 0; i < 6; ++i) {
    if (eigen.eigenvalues()(i) < 1e-3 * eigen.eigenvalues()(5)) continue;
    squared += along(i) * along(i) / eigen.eigenvalues()(i);
    ++dof;
  }
  if (dof == 0) return 1;
  return boost::math::cdf(
      boost::math::complement(boost::math::chi_squared{static_cast<double>(dof)}, squared));
}

void summarise(const std::vector<Contact>& contacts, const RigidFit& start, SurfaceFit& fit) {
  double sum = 0, squares = 0;
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  for (const Contact& c : contacts) {
    sum += std::abs(c.residual_mm);
    squares += c.residual_mm * c.residual_mm;
    centre += c.q_camera_mm;
  }
  const auto n = static_cast<double>(contacts.size());
  centre /= n;
  fit.closest_point_mean_mm = sum / n;
  fit.closest_point_rmse_mm = std::sqrt(squares / n);
  fit.shift_mm = (start.T_camera_ct * fit.T_camera_ct.inverse() * centre - centre).norm();
}

}  // namespace

SurfaceFit fuse_surface(const RigidFit& start, const std::vector<Eigen::Vector3d>& p_camera_mm,
                        const TriangleTree& ct, const SurfaceFitOptions& options) {
  SurfaceFit fit;
  fit.T_camera_ct = start.T_camera_ct;
  const std::vector<Eigen::Vector3d> points = drawn(p_camera_mm, options);
  const Matrix6d prior = start.covariance.ldlt().solve(Matrix6d::Identity());
  for (int i = 0; i < kIterationsMax; ++i) {
    std::vector<Contact> on_surface = contacts(points, ct, fit.T_camera_ct, options.within_mm);
    fit.overlap = points.empty()
                      ? 0
                      : static_cast<double>(on_surface.size()) / static_cast<double>(points.size());
    if (on_surface.size() < 50 || fit.overlap < options.overlap_min) {
      fit.status = SurfaceFitStatus::no_overlap;
      return fit;
    }
    gate(on_surface);
    const std::map<Cell, Region> grouped = regions(on_surface, options.region_mm);
    measure_noise(grouped, options.regional_min_mm, fit);
    Matrix6d information = prior;
    Vector6d gradient = prior * difference(fit.T_camera_ct, start.T_camera_ct);
    add_information(grouped, fit, information, gradient);
    const Eigen::LDLT<Matrix6d> normal{information};
    const Vector6d step = normal.solve(gradient);
    if (!step.allFinite()) return fit;
    fit.T_camera_ct = moved(fit.T_camera_ct, step);
    fit.covariance = normal.solve(Matrix6d::Identity());
    if (step.head<3>().norm() + 100 * step.tail<3>().norm() > kStepMinMm) continue;
    summarise(on_surface, start, fit);
    fit.p_value = p_value_of_shift(difference(start.T_camera_ct, fit.T_camera_ct), start.covariance,
                                   fit.covariance);
    fit.status = fit.p_value < options.disagreement_p_min ? SurfaceFitStatus::disagreement
                                                          : SurfaceFitStatus::fused;
    return fit;
  }
  return fit;
}

}  // namespace holdfast::registration
