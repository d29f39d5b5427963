// SPDX-License-Identifier: Apache-2.0
#include "registration/fiducial_checks.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <boost/math/distributions/chi_squared.hpp>
#include <boost/math/distributions/fisher_f.hpp>

namespace holdfast::registration {
namespace {

constexpr std::size_t kMovingMax = 16, kFixedMax = 64, kRivalsMax = 63;
constexpr double kInfinite = std::numeric_limits<double>::infinity();

double fre_of(const Eigen::Matrix3Xd& to, const Eigen::Matrix3Xd& from) {
  const Eigen::Matrix3Xd moved = horn(to, from) * from;
  return std::sqrt((to - moved).squaredNorm() / static_cast<double>(to.cols()));
}

/// Depth-first over assignments; two points' distance may differ between the frames by no more than
/// an accepted FRE allows.
class Search {
 public:
  Search(const std::vector<Eigen::Vector3d>& fixed, const std::vector<Eigen::Vector3d>& moving,
         double fre_max_mm)
      : fixed_(fixed), moving_(moving), fre_max_mm_(fre_max_mm), is_used_(fixed.size(), false) {}

  Correspondence run() {
    result_.fre_mm = result_.second_fre_mm = kInfinite;
    descend();
    if (result_.fre_mm > fre_max_mm_)
      result_.status = CorrespondenceStatus::none;
    else if (result_.second_fre_mm <= fre_max_mm_)
      result_.status = CorrespondenceStatus::ambiguous;
    else
      result_.status = CorrespondenceStatus::found;
    if (result_.status == CorrespondenceStatus::ambiguous) {
      result_.candidates.reserve(1 + rivals_.size());
      result_.candidates.push_back(result_.fixed_of_moving);
      for (const auto& rival : rivals_) result_.candidates.push_back(rival);
      ++result_.candidate_count;
    } else {
      result_.candidate_count = 0;
    }
    if (result_.status != CorrespondenceStatus::found) result_.fixed_of_moving.clear();
    return result_;
  }

 private:
  /// With N residuals of root mean square f none is longer than f·sqrt(N), and a distance between
  /// two points changes by at most the sum of two, whose squares share N·f^2: f·sqrt(2N).
  [[nodiscard]] bool is_possible(std::size_t candidate) const {
    const double tolerance = fre_max_mm_ * std::sqrt(2.0 * static_cast<double>(moving_.size()));
    const Eigen::Vector3d& p = moving_[chosen_.size()];
    for (std::size_t i = 0; i < chosen_.size(); ++i)
      if (std::abs((p - moving_[i]).norm() - (fixed_[candidate] - fixed_[chosen_[i]]).norm()) >
          tolerance)
        return false;
    return true;
  }

  void descend() {
    if (chosen_.size() == moving_.size()) return judge();
    for (std::size_t candidate = 0; candidate < fixed_.size(); ++candidate) {
      if (is_used_[candidate] || !is_possible(candidate)) continue;
      is_used_[candidate] = true;
      chosen_.push_back(candidate);
      descend();
      chosen_.pop_back();
      is_used_[candidate] = false;
    }
  }

  void judge() {
    const auto n = static_cast<Eigen::Index>(moving_.size());
    Eigen::Matrix3Xd to(3, n), from(3, n);
    for (Eigen::Index i = 0; i < n; ++i) {
      to.col(i) = moving_[static_cast<std::size_t>(i)];
      from.col(i) = fixed_[chosen_[static_cast<std::size_t>(i)]];
    }
    const double fre_mm = fre_of(to, from);
    if (fre_mm < result_.fre_mm) {
      result_.second_fre_mm = result_.fre_mm;
      if (result_.fre_mm <= fre_max_mm_) keep_rival(result_.fixed_of_moving);
      result_.fre_mm = fre_mm;
      result_.fixed_of_moving = chosen_;
    } else {
      result_.second_fre_mm = std::min(result_.second_fre_mm, fre_mm);
      if (fre_mm <= fre_max_mm_) keep_rival(chosen_);
    }
  }

  void keep_rival(const std::vector<std::size_t>& fixed_of_moving) {
    ++result_.candidate_count;
    if (rivals_.size() < kRivalsMax) rivals_.push_back(fixed_of_moving);
  }

  const std::vector<Eigen::Vector3d>& fixed_;
  const std::vector<Eigen::Vector3d>& moving_;
  double fre_max_mm_;
  std::vector<bool> is_used_;
  std::vector<std::size_t> chosen_;
  std::vector<std::vector<std::size_t>> rivals_;
  Correspondence result_;
};

Eigen::Matrix3Xd points(const FiducialSet& set, Eigen::Vector3d FiducialPair::*member) {
  Eigen::Matrix3Xd p(3, static_cast<Eigen::Index>(set.pairs.size()));
  for (std::size_t i = 0; i < set.pairs.size(); ++i)
    p.col(static_cast<Eigen::Index>(i)) = set.pairs[i].*member;
  return p;
}

/// The probability of a prediction error at least as unlikely: chi-squared where the covariances
/// are stated; Fisher, against what the other residuals show, where they are not.
double p_value_of(double mahalanobis, double chi_squared, int dof, bool has_covariances) {
  namespace math = boost::math;
  if (has_covariances) return math::cdf(math::complement(math::chi_squared{3}, mahalanobis));
  const double rest = std::max(chi_squared - mahalanobis, 1e-30 * chi_squared);
  if (!(rest > 0)) return 1;
  const double ratio = (mahalanobis / 3) / (rest / (dof - 3));
  return math::cdf(math::complement(math::fisher_f{3, static_cast<double>(dof - 3)}, ratio));
}

}  // namespace

Correspondence find_correspondence(const std::vector<Eigen::Vector3d>& fixed_mm,
                                   const std::vector<Eigen::Vector3d>& moving_mm,
                                   double fre_max_mm) {
  Correspondence result;
  result.fre_mm = result.second_fre_mm = kInfinite;
  if (moving_mm.size() > kMovingMax || fixed_mm.size() > kFixedMax) {
    result.status = CorrespondenceStatus::too_many;
    return result;
  }
  if (moving_mm.size() < 3 || fixed_mm.size() < moving_mm.size()) return result;
  return Search{fixed_mm, moving_mm, fre_max_mm}.run();
}

std::vector<LeftOut> leave_one_out(const FiducialSet& fiducials, const RigidFit& fit) {
  std::vector<LeftOut> result;
  const auto n = static_cast<Eigen::Index>(fiducials.pairs.size());
  if (n < 4 || fit.status != FitStatus::fitted) return result;
  const Eigen::MatrixXd noise = fiducial_noise(fiducials, fit.T_camera_ct);
  Eigen::MatrixXd J(3 * n, 6);
  Eigen::VectorXd y(3 * n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const FiducialPair& pair = fiducials.pairs[static_cast<std::size_t>(i)];
    J.middleRows<3>(3 * i) = point_jacobian(fit.T_camera_ct, pair.p_ct_mm);
    y.segment<3>(3 * i) = pair.p_camera_mm - fit.T_camera_ct * pair.p_ct_mm;
  }
  // With W the inverse noise and Q = W - WJ(J'WJ)^-1 J'W, the prediction error of block i from all
  // the others is Q_ii^-1 (Qy)_i, and its covariance Q_ii^-1.
  const Eigen::MatrixXd W = noise.llt().solve(Eigen::MatrixXd::Identity(3 * n, 3 * n));
  const Eigen::MatrixXd WJ = W * J;
  const Eigen::MatrixXd Q = W - WJ * (J.transpose() * WJ).ldlt().solve(WJ.transpose());
  const Eigen::VectorXd Qy = Q * y;
  const double chi_squared = y.dot(Qy);
  for (Eigen::Index i = 0; i < n; ++i) {
    const Eigen::Matrix3d Q_ii = Q.block<3, 3>(3 * i, 3 * i);
    const Eigen::Vector3d displacement = Q_ii.ldlt().solve(Qy.segment<3>(3 * i));
    LeftOut left_out;
    left_out.label = fiducials.pairs[static_cast<std::size_t>(i)].label;
    left_out.displacement_mm = displacement.norm();
    left_out.p_value = p_value_of(displacement.dot(Q_ii * displacement), chi_squared,
                                  fit.degrees_of_freedom, fiducials.has_covariances);
    result.push_back(left_out);
  }
  return result;
}

double mirrored_fre_mm(const FiducialSet& fiducials) {
  Eigen::Matrix3Xd mirrored = points(fiducials, &FiducialPair::p_ct_mm);
  mirrored.row(0) = -mirrored.row(0);
  return fre_of(points(fiducials, &FiducialPair::p_camera_mm), mirrored);
}

}  // namespace holdfast::registration
