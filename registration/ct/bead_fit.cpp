// SPDX-License-Identifier: Apache-2.0
#include "registration/ct/bead_fit.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/LU>

namespace holdfast::registration {
namespace {

constexpr double kShellMm = 1.3;  // of surroundings that the fit sees
constexpr double kModelErrorMm = 0.01;
constexpr double kHighestMetalHu = 30'000;

/// Parameters: centre (3), log blur, log elongation, background, contrast; then, where a flat side
/// is near, its step and the plane p·x - q in units of its own blur.
constexpr int kBlur = 3, kLong = 4, kBackground = 5, kContrast = 6, kStep = 7, kPlane = 8,
              kOffset = 11;
constexpr int kBallOnly = 7, kWithSide = 12;

struct Voxel {
  Eigen::Vector3d p_mm;  // from the start point
  double hu;
  std::array<int, 3> index;
};

/// A ball of radius `radius` under a Gaussian of standard deviation `blur`, at distance r.
double blurred_ball(double r, double radius, double blur) {
  const double k = 1 / (std::numbers::sqrt2 * blur);
  const double inside = 0.5 * (std::erf((radius + r) * k) + std::erf((radius - r) * k));
  const double u = (radius - r) * k, v = (radius + r) * k;
  if (r < 1e-6 * radius)
    return std::erf(radius * k) -
           2 * radius * k * std::numbers::inv_sqrtpi * std::exp(-radius * radius * k * k);
  return inside -
         blur / (std::sqrt(2 * std::numbers::pi) * r) * (std::exp(-u * u) - std::exp(-v * v));
}

class Problem {
 public:
  Problem(const CtVolume& volume, const Eigen::Vector3d& start, double radius_mm, int highest_hu)
      : volume_(volume),
        start_(start),
        radius_mm_(radius_mm),
        highest_hu_(highest_hu),
        normal_(volume.column_step_mm.cross(volume.row_step_mm).normalized()) {
    gather();
  }

  [[nodiscard]] const std::vector<Voxel>& voxels() const { return voxels_; }
  [[nodiscard]] bool is_clipped(double hu) const { return hu >= highest_hu_; }

  [[nodiscard]] double model(const Eigen::VectorXd& x, double stretch, double blur_mm,
                             const Voxel& voxel) const {
    const Eigen::Vector3d d = voxel.p_mm - x.head<3>();
    const double along = d.dot(normal_), across2 = std::max(d.squaredNorm() - along * along, 0.0);
    const double scaled = along / stretch;
    double hu = x[kBackground] + x[kContrast] * blurred_ball(std::sqrt(across2 + scaled * scaled),
                                                             radius_mm_, blur_mm);
    if (x.size() == kWithSide) {
      const double depth = x.segment<3>(kPlane).dot(voxel.p_mm) - x[kOffset];
      hu += x[kStep] * 0.5 * std::erfc(-depth / std::numbers::sqrt2);
    }
    return std::clamp(hu, -1024.0, static_cast<double>(highest_hu_));
  }

  [[nodiscard]] Eigen::VectorXd residuals(const Eigen::VectorXd& x) const {
    Eigen::VectorXd r(static_cast<Eigen::Index>(voxels_.size()));
    const double stretch = std::exp(x[kLong]), blur_mm = std::exp(x[kBlur]);
    for (Eigen::Index k = 0; k < r.size(); ++k) {
      const Voxel& voxel = voxels_[static_cast<std::size_t>(k)];
      r[k] = std::max(voxel.hu, -1024.0) - model(x, stretch, blur_mm, voxel);
    }
    return r;
  }

  [[nodiscard]] Eigen::MatrixXd jacobian(const Eigen::VectorXd& x) const {
    Eigen::MatrixXd jacobian(static_cast<Eigen::Index>(voxels_.size()), x.size());
    for (Eigen::Index p = 0; p < x.size(); ++p) {
      const double h = p == kBackground || p == kContrast || p == kStep ? 1.0 : 1e-4;
      Eigen::VectorXd up = x, down = x;
      up[p] += h;
      down[p] -= h;
      jacobian.col(p) = (residuals(up) - residuals(down)) / (2 * h);
    }
    return jacobian;
  }

  static bool is_plausible(const Eigen::VectorXd& x) {
    return x.allFinite() && x.head<3>().norm() < 3 && std::abs(x[kBlur] + 1) < 2 &&
           std::abs(x[kLong]) < 1 && std::abs(x[kContrast]) < kHighestMetalHu;
  }

  /// Levenberg-Marquardt. True when the steps have become small.
  bool solve(Eigen::VectorXd& x) const {
    double damping = 1e-3;
    Eigen::VectorXd r = residuals(x);
    for (int iteration = 0; iteration < 60; ++iteration) {
      const Eigen::MatrixXd J = jacobian(x);
      const Eigen::MatrixXd H = J.transpose() * J;
      const Eigen::VectorXd g = J.transpose() * r;
      bool has_moved = false;
      while (!has_moved && damping < 1e9) {
        Eigen::MatrixXd damped = H;
        damped.diagonal() +=
            damping * (H.diagonal().array() + 1e-9 * H.diagonal().maxCoeff()).matrix();
        const Eigen::VectorXd step = damped.ldlt().solve(-g);
        const Eigen::VectorXd next = x + step;
        const Eigen::VectorXd r_next = is_plausible(next) ? residuals(next) : r;
        if (!is_plausible(next) || !(r_next.squaredNorm() < r.squaredNorm())) {
          damping *= 4;
          continue;
        }
        const bool is_small = step.head<3>().norm() < 1e-5 &&
                              r.squaredNorm() - r_next.squaredNorm() < 1e-6 * r.squaredNorm();
        has_moved = true;
        x = next;
        r = r_next;
        damping = std::max(damping / 8, 1e-12);
        if (is_small) return true;
      }
      if (!has_moved) return true;  // no direction leads down any more
    }
    return false;
  }

  [[nodiscard]] double noise_inflation(const Eigen::VectorXd& r) const;

 private:
  void gather() {
    const double reach_mm = radius_mm_ + kShellMm;
    const Eigen::Affine3d index_from_ct = volume_.ct_from_index().inverse();
    const Eigen::Vector3d middle = index_from_ct * start_;
    const Eigen::Vector3d half =
        index_from_ct.linear().rowwise().norm() * reach_mm + Eigen::Vector3d::Ones();
    std::array<int, 3> low{}, high{};
    for (int a = 0; a < 3; ++a) {
      const auto axis = static_cast<std::size_t>(a);
      const double end = volume_.size[axis] - 1;
      low[axis] = static_cast<int>(std::clamp(std::floor(middle[a] - half[a]), 0.0, end));
      high[axis] = static_cast<int>(std::clamp(std::ceil(middle[a] + half[a]), 0.0, end));
    }
    for (int k = low[2]; k <= high[2]; ++k)
      for (int j = low[1]; j <= high[1]; ++j)
        for (int i = low[0]; i <= high[0]; ++i) {
          const Eigen::Vector3d p = volume_.point_at(Eigen::Vector3d(i, j, k)) - start_;
          if (p.norm() > reach_mm) continue;
          const auto at = (static_cast<std::size_t>(k) * static_cast<std::size_t>(volume_.size[1]) +
                           static_cast<std::size_t>(j)) *
                              static_cast<std::size_t>(volume_.size[0]) +
                          static_cast<std::size_t>(i);
          voxels_.push_back({p, static_cast<double>(volume_.hu[at]), {i, j, k}});
        }
  }

  const CtVolume& volume_;
  Eigen::Vector3d start_;
  double radius_mm_;
  int highest_hu_;
  Eigen::Vector3d normal_ = Eigen::Vector3d::UnitZ();
  std::vector<Voxel> voxels_;
};

/// By how much the variance of a mean grows because neighbouring residuals are alike.
double Problem::noise_inflation(const Eigen::VectorXd& r) const {
  std::array<double, 3> product{};
  std::array<int, 3> pairs{};
  // Voxels stand in index order, so the next column is the next entry; the others are searched.
  const auto find = [&](const std::array<int, 3>& index) {
    const auto it = std::lower_bound(
        voxels_.begin(), voxels_.end(), index, [](const Voxel& a, const std::array<int, 3>& b) {
          return std::tie(a.index[2], a.index[1], a.index[0]) < std::tie(b[2], b[1], b[0]);
        });
    return it != voxels_.end() && it->index == index ? it - voxels_.begin() : -1;
  };
  for (std::size_t k = 0; k < voxels_.size(); ++k)
    for (std::size_t axis = 0; axis < 3; ++axis) {
      std::array<int, 3> next = voxels_[k].index;
      ++next[axis];
      const auto other = find(next);
      if (other < 0) continue;
      product[axis] += r[static_cast<Eigen::Index>(k)] * r[other];
      ++pairs[axis];
    }
  const double variance =
      r.squaredNorm() / static_cast<double>(std::max<Eigen::Index>(r.size(), 1));
  double inflation = 1;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    if (pairs[axis] == 0 || !(variance > 0)) continue;
    const double rho = std::clamp(product[axis] / pairs[axis] / variance, 0.0, 0.8);
    inflation *= (1 + rho) / (1 - rho);
  }
  return inflation;
}

/// A start for the flat side: where the surroundings are darkest.
Eigen::VectorXd with_side(const Problem& problem, const Eigen::VectorXd& ball, double radius_mm) {
  Eigen::Vector3d towards = Eigen::Vector3d::Zero();
  double low = 1e9, high = -1e9;
  for (const Voxel& voxel : problem.voxels()) {
    const Eigen::Vector3d d = voxel.p_mm - ball.head<3>();
    if (d.norm() < radius_mm + 0.7) continue;
    towards += (ball[kBackground] - voxel.hu) * d.normalized();
    low = std::min(low, voxel.hu);
    high = std::max(high, voxel.hu);
  }
  Eigen::VectorXd x(kWithSide);
  x.head(kBallOnly) = ball;
  x[kStep] = -std::max(high - low, 10.0) / 2;
  const Eigen::Vector3d n = towards.norm() > 0 ? towards.normalized() : Eigen::Vector3d::UnitZ();
  x.segment<3>(kPlane) = n / 0.5;
  x[kOffset] = (n.dot(ball.head<3>()) + radius_mm + 0.4) / 0.5;
  return x;
}

double sphericity_of(const Problem& problem, const Eigen::Vector3d& centre, double reach_mm,
                     double background_hu, double top_hu) {
  const double middle = (background_hu + top_hu) / 2;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  Eigen::Matrix3d moment = Eigen::Matrix3d::Zero();
  double weights = 0;
  for (const Voxel& voxel : problem.voxels()) {
    if ((voxel.p_mm - centre).norm() > reach_mm) continue;
    const double w = std::clamp((voxel.hu - middle) / std::max(top_hu - middle, 1.0), 0.0, 1.0);
    mean += w * voxel.p_mm;
    moment += w * voxel.p_mm * voxel.p_mm.transpose();
    weights += w;
  }
  if (!(weights > 0)) return 0;
  mean /= weights;
  const Eigen::Matrix3d spread = moment / weights - mean * mean.transpose();
  const Eigen::Vector3d axes =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(spread, Eigen::EigenvaluesOnly).eigenvalues();
  return std::sqrt(std::max(axes[0], 0.0) / std::max(axes[2], 1e-12));
}

Eigen::VectorXd first_guess(const Problem& problem, double highest_hu) {
  std::vector<double> values;
  for (const Voxel& voxel : problem.voxels()) values.push_back(voxel.hu);
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  Eigen::VectorXd x = Eigen::VectorXd::Zero(kBallOnly);
  x[kBlur] = std::log(0.4);
  x[kBackground] = *middle;
  const double top = *std::max_element(values.begin(), values.end());
  x[kContrast] = (top - *middle) * (top >= highest_hu ? 2 : 1.2);
  return x;
}

}  // namespace

BeadFit fit_bead(const CtVolume& volume, const Eigen::Vector3d& p_start_ct_mm, double diameter_mm,
                 int highest_hu) {
  const double radius_mm = diameter_mm / 2;
  const Problem problem(volume, p_start_ct_mm, radius_mm, highest_hu);
  BeadFit fit;
  const auto n = static_cast<double>(problem.voxels().size());
  if (n < 3 * kWithSide) return fit;
  const Eigen::VectorXd guess = first_guess(problem, highest_hu);
  Eigen::VectorXd x = guess;
  fit.has_converged = problem.solve(x);
  const double plain = problem.residuals(x).squaredNorm();
  // A side whose step is as large as the ball's contrast spoils the fit of the ball alone, so the
  // fit with a side starts from both. It is believed only where it explains much of what is left.
  double best = 0.8 * plain;
  for (const Eigen::VectorXd& ball : {guess, Eigen::VectorXd(x.head(kBallOnly))}) {
    Eigen::VectorXd sided = with_side(problem, ball, radius_mm);
    const bool has_converged = problem.solve(sided);
    const double left = problem.residuals(sided).squaredNorm();
    if (!has_converged || !(left < best)) continue;
    best = left;
    x = sided;
    fit.has_converged = true;
  }
  const Eigen::VectorXd r = problem.residuals(x);
  const Eigen::MatrixXd J = problem.jacobian(x);
  Eigen::MatrixXd H = J.transpose() * J;
  H.diagonal() *= 1 + 1e-9;
  const Eigen::MatrixXd inverse = H.ldlt().solve(Eigen::MatrixXd::Identity(H.rows(), H.cols()));
  const double variance = r.squaredNorm() / (n - static_cast<double>(x.size()));
  fit.covariance_mm2 = inverse.topLeftCorner<3, 3>() * variance * problem.noise_inflation(r) +
                       Eigen::Matrix3d::Identity() * kModelErrorMm * kModelErrorMm;
  fit.covariance_mm2 = (fit.covariance_mm2 + fit.covariance_mm2.transpose()).eval() / 2;
  fit.has_converged = fit.has_converged && fit.covariance_mm2.allFinite();
  fit.p_ct_mm = p_start_ct_mm + x.head<3>();
  // Beside the ball's centre: with a side, either half may be the one called background.
  fit.background_hu = x[kBackground];
  if (x.size() == kWithSide)
    fit.background_hu +=
        x[kStep] * 0.5 *
        std::erfc(-(x.segment<3>(kPlane).dot(x.head<3>()) - x[kOffset]) / std::numbers::sqrt2);
  fit.blur_mm = std::exp(x[kBlur]);
  fit.elongation = std::exp(x[kLong]);
  double top = -1e9;
  for (const Voxel& voxel : problem.voxels()) top = std::max(top, voxel.hu);
  fit.is_clipped = problem.is_clipped(top);
  fit.contrast_hu = top - fit.background_hu;
  fit.residual_share = std::sqrt(r.squaredNorm() / n) / std::max(std::abs(fit.contrast_hu), 1.0);
  fit.sphericity = sphericity_of(problem, x.head<3>(), radius_mm + 0.8, fit.background_hu, top);
  return fit;
}

}  // namespace holdfast::registration
