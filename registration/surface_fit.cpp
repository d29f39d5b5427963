// SPDX-License-Identifier: Apache-2.0
#include "registration/surface_fit.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <tuple>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <boost/math/distributions/chi_squared.hpp>

#include "registration/point_sample.hpp"

namespace holdfast::registration {
namespace {

constexpr int kIterationsMax = 30;
constexpr double kStepMinSquared = 1e-2;  // in standard deviations: a tenth of one
constexpr double kHopMaxSquared = 0.25;   // half of one
constexpr int kFieldAgain = 3;            // iteration
constexpr double kGate = 4;  // robust standard deviations beyond which a point does not vote
// Where the surface falls away from the camera, and where little of it is known, the matcher mixes
// what is near with what is far: such points have one sign and their neighbours' company, and no
// average removes them.
constexpr double kFacingMin = 0.35;     // cosine between the normal and the line of sight
constexpr double kPatchShareMin = 0.3;  // of the median patch's points
constexpr double kMadToSigma = 1.4826;
constexpr std::size_t kContactsMin = 50;

/// One point that lies on the CT surface: residual r = n·(p - q), with d(n·q) = h·step.
struct Contact {
  double residual_mm;
  Vector6d h;
  Eigen::Vector3d p_camera_mm;
  bool is_steep;  ///< seen at so flat an angle that it does not vote
};

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
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
    result.push_back({n.dot(p - q), point_jacobian(T_camera_ct, closest.p_mm).transpose() * n, p,
                      std::abs(n.dot(p)) < kFacingMin * p.norm()});
  }
  return result;
}

/// Leaves out what is steep, and what is too far from the rest.
void gate(std::vector<Contact>& contacts) {
  std::erase_if(contacts, [](const Contact& c) { return c.is_steep; });
  if (contacts.empty()) return;
  std::vector<double> magnitudes;
  for (const Contact& c : contacts) magnitudes.push_back(std::abs(c.residual_mm));
  const double limit = kGate * kMadToSigma * median(magnitudes) + 1e-9;
  std::erase_if(contacts, [limit](const Contact& c) { return std::abs(c.residual_mm) > limit; });
}

/// The contacts of one small piece of the reconstructed surface: their median residual, the rest
/// averaged.
struct Patch {
  double count = 0, residual_mm = 0;
  Vector6d h = Vector6d::Zero();
  Eigen::Vector3d centre_camera_mm = Eigen::Vector3d::Zero();
  std::vector<double> residuals_mm;
};

std::vector<Patch> patches(const std::vector<Contact>& contacts, double size_mm) {
  using Cell = std::tuple<int, int, int>;
  std::map<Cell, Patch> cells;
  for (const Contact& c : contacts) {
    const Eigen::Vector3i cell = (c.p_camera_mm / size_mm).array().floor().cast<int>();
    Patch& patch = cells[{cell.x(), cell.y(), cell.z()}];
    patch.count += 1;
    patch.h += c.h;
    patch.centre_camera_mm += c.p_camera_mm;
    patch.residuals_mm.push_back(c.residual_mm);
  }
  std::vector<double> counts;
  for (const auto& [cell, patch] : cells) counts.push_back(patch.count);
  const double least = kPatchShareMin * (counts.empty() ? 0 : median(counts));
  std::vector<Patch> result;
  for (auto& [cell, patch] : cells) {
    if (patch.count < least) continue;
    patch.residual_mm = median(patch.residuals_mm);
    patch.h /= patch.count;
    patch.centre_camera_mm /= patch.count;
    result.push_back(std::move(patch));
  }
  return result;
}

/// Leaves out the patches that are too far from the others. About their median: where they all lie
/// off alike the pose is off, not they.
void gate(std::vector<Patch>& patches) {
  std::vector<double> residuals, magnitudes;
  for (const Patch& p : patches) residuals.push_back(p.residual_mm);
  const double middle = median(residuals);
  for (const double r : residuals) magnitudes.push_back(std::abs(r - middle));
  const double limit = kGate * kMadToSigma * median(magnitudes) + 1e-9;
  std::erase_if(patches, [&](const Patch& p) { return std::abs(p.residual_mm - middle) > limit; });
}

/// 1 sigma of a point about its patch, robust.
double point_noise_mm(const std::vector<Patch>& patches) {
  constexpr double kFloorMm = 1e-3;
  std::vector<double> deviations;
  for (const Patch& patch : patches)
    if (patch.count >= 3)
      for (const double r : patch.residuals_mm)
        deviations.push_back(std::abs(r - patch.residual_mm));
  return deviations.empty() ? kFloorMm : std::max(kFloorMm, kMadToSigma * median(deviations));
}

/// The patches' residuals as a linear model y = H·step + e, e of covariance noise + field.
struct Model {
  Eigen::VectorXd y, noise_mm2;  // variance of each patch's mean
  Eigen::MatrixXd H, correlation;

  Model(const std::vector<Patch>& patches, double point_noise_mm, double correlation_mm) {
    const auto n = static_cast<Eigen::Index>(patches.size());
    y.resize(n);
    noise_mm2.resize(n);
    H.resize(n, 6);
    correlation.resize(n, n);
    for (Eigen::Index i = 0; i < n; ++i) {
      const Patch& patch = patches[static_cast<std::size_t>(i)];
      y(i) = patch.residual_mm;
      H.row(i) = patch.h.transpose();
      noise_mm2(i) = point_noise_mm * point_noise_mm / patch.count;
      for (Eigen::Index j = 0; j < n; ++j) {
        const Patch& other = patches[static_cast<std::size_t>(j)];
        correlation(i, j) =
            std::exp(-(patch.centre_camera_mm - other.centre_camera_mm).norm() / correlation_mm);
      }
    }
  }
};

struct Solution {
  Matrix6d information;
  Vector6d gradient;
  double restricted_log_likelihood;
};

/// Generalised least squares under a field of `field_mm`, and how likely such a field is once the
/// six numbers of the motion are fitted (restricted likelihood, constants left out).
Solution solve(const Model& model, double field_mm, double offset_mm) {
  Eigen::MatrixXd covariance = field_mm * field_mm * model.correlation;
  covariance.array() += offset_mm * offset_mm;
  covariance.diagonal() += model.noise_mm2;
  const Eigen::LLT<Eigen::MatrixXd> root{covariance};
  const Eigen::MatrixXd H = root.matrixL().solve(model.H);
  const Eigen::VectorXd y = root.matrixL().solve(model.y);
  Solution s{H.transpose() * H, H.transpose() * y, 0};
  const Eigen::LDLT<Matrix6d> normal{s.information};
  const double rest = y.squaredNorm() - s.gradient.dot(normal.solve(s.gradient));
  const Eigen::MatrixXd L = root.matrixL();
  s.restricted_log_likelihood = -L.diagonal().array().log().sum() -
                                0.5 * normal.vectorD().array().abs().log().sum() - 0.5 * rest;
  return s;
}

/// The field that the residuals speak for, at least `field_min_mm`; steps of a fifth.
double likeliest_field_mm(const Model& model, double field_min_mm, double offset_mm) {
  constexpr double kStep = 1.2;
  constexpr int kStepsMax = 16;
  double best = field_min_mm;
  double best_likelihood = solve(model, best, offset_mm).restricted_log_likelihood;
  double field = best;
  for (int i = 0; i < kStepsMax; ++i) {
    field *= kStep;
    const double likelihood = solve(model, field, offset_mm).restricted_log_likelihood;
    if (!(likelihood > best_likelihood)) break;
    best = field;
    best_likelihood = likelihood;
  }
  return best;
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
    centre += c.p_camera_mm;
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
  std::vector<Eigen::Vector3d> points = p_camera_mm;
  draw(points, options.points, options.seed);
  const Matrix6d own = start.covariance - start.common_covariance;
  const Matrix6d prior = own.ldlt().solve(Matrix6d::Identity());
  for (int i = 0; i < kIterationsMax; ++i) {
    std::vector<Contact> on_surface = contacts(points, ct, fit.T_camera_ct, options.within_mm);
    fit.overlap = points.empty()
                      ? 0
                      : static_cast<double>(on_surface.size()) / static_cast<double>(points.size());
    if (on_surface.size() < kContactsMin || fit.overlap < options.overlap_min) {
      fit.status = SurfaceFitStatus::no_overlap;
      return fit;
    }
    gate(on_surface);
    if (on_surface.size() < kContactsMin) {
      fit.status = SurfaceFitStatus::no_overlap;
      return fit;
    }
    std::vector<Patch> grouped = patches(on_surface, options.patch_mm);
    gate(grouped);
    fit.noise_mm = point_noise_mm(grouped);
    const Model model{grouped, fit.noise_mm, options.correlation_mm};
    // The field is judged twice: at the start, and once the surfaces lie on each other.
    if (i == 0 || i == kFieldAgain)
      fit.field_mm = likeliest_field_mm(model, options.field_min_mm, options.offset_mm);
    const Solution surface = solve(model, fit.field_mm, options.offset_mm);
    const Matrix6d information = prior + surface.information;
    const Vector6d gradient =
        prior * difference(fit.T_camera_ct, start.T_camera_ct) + surface.gradient;
    const Eigen::LDLT<Matrix6d> normal{information};
    const Vector6d step = normal.solve(gradient);
    if (!step.allFinite()) return fit;
    fit.T_camera_ct = moved(fit.T_camera_ct, step);
    fit.covariance = normal.solve(Matrix6d::Identity());
    const double step_squared = step.dot(information * step);
    if (i < kFieldAgain || step_squared > kStepMinSquared) {
      // Points hop between triangles, so a small step may never vanish: then the rest is
      // uncertainty.
      if (i + 1 < kIterationsMax || step_squared > kHopMaxSquared) continue;
      fit.covariance *= 1 + step_squared;
    }
    summarise(on_surface, start, fit);
    fit.p_value =
        p_value_of_shift(difference(start.T_camera_ct, fit.T_camera_ct), own, fit.covariance);
    fit.covariance += start.common_covariance;
    fit.status = fit.p_value < options.disagreement_p_min ? SurfaceFitStatus::disagreement
                                                          : SurfaceFitStatus::fused;
    return fit;
  }
  return fit;
}

}  // namespace holdfast::registration
