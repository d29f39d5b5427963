// SPDX-License-Identifier: Apache-2.0
#include "safety/numbers.hpp"

#include <cmath>

#include <Eigen/Cholesky>

namespace holdfast::safety {
namespace {

/// Of correlations: far above double rounding, far below anything that matters.
constexpr double kCovarianceTolerance = 1e-9;

}  // namespace

bool is_rigid(const Eigen::Isometry3d& T, double tolerance) noexcept {
  if (!T.matrix().allFinite()) return false;
  if (T.matrix().row(3) != Eigen::RowVector4d(0, 0, 0, 1)) return false;
  const Eigen::Matrix3d R = T.linear();
  const Eigen::Matrix3d deviation = R.transpose() * R - Eigen::Matrix3d::Identity();
  return !exceeds(deviation.cwiseAbs().maxCoeff(), tolerance) && R.determinant() > 0;
}

bool is_covariance(const Matrix6d& covariance) noexcept {
  if (!covariance.allFinite()) return false;
  const Eigen::Matrix<double, 6, 1> variance = covariance.diagonal();
  if (!(variance.minCoeff() > 0)) return false;
  // As correlations, so that mm and rad are judged alike.
  const Eigen::Matrix<double, 6, 1> weight = variance.cwiseSqrt().cwiseInverse();
  const Matrix6d correlation = weight.asDiagonal() * covariance * weight.asDiagonal();
  const Matrix6d asymmetry = correlation - correlation.transpose();
  if (exceeds(asymmetry.cwiseAbs().maxCoeff(), kCovarianceTolerance)) return false;
  const Matrix6d lifted = correlation + kCovarianceTolerance * Matrix6d::Identity();
  return Eigen::LLT<Matrix6d>(lifted).info() == Eigen::Success;
}

bool is_magnitude(double value) noexcept {
  return std::isfinite(value) && value >= 0;
}

Duration elapsed(Timestamp from, Timestamp to) noexcept {
  Duration::rep difference = 0;
  if (__builtin_sub_overflow(to.count(), from.count(), &difference)) {
    return to < from ? Duration::min() : Duration::max();
  }
  return Duration(difference);
}

}  // namespace holdfast::safety
