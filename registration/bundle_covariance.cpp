// SPDX-License-Identifier: Apache-2.0
#include "registration/bundle_covariance.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include <Eigen/Cholesky>
#include <ceres/crs_matrix.h>

namespace holdfast::registration::bundle {
namespace {

/// JᵀJ, the lower half.
Eigen::MatrixXd normal_matrix(const ceres::CRSMatrix& jacobian) {
  Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(jacobian.num_cols, jacobian.num_cols);
  for (std::size_t r = 0; r < static_cast<std::size_t>(jacobian.num_rows); ++r) {
    const auto first = static_cast<std::size_t>(jacobian.rows[r]);
    const auto last = static_cast<std::size_t>(jacobian.rows[r + 1]);
    for (std::size_t a = first; a < last; ++a)
      for (std::size_t b = first; b <= a; ++b)
        normal(std::max(jacobian.cols[a], jacobian.cols[b]),
               std::min(jacobian.cols[a], jacobian.cols[b])) +=
            jacobian.values[a] * jacobian.values[b];
  }
  return normal;
}

/// The first `size` rows and columns of the inverse of a matrix given by its lower half.
Eigen::MatrixXd leading_inverse(const Eigen::MatrixXd& lower, Eigen::Index size) {
  const Eigen::VectorXd scale =
      lower.diagonal().unaryExpr([](double d) { return d > 0 ? 1 / std::sqrt(d) : 1.0; });
  Eigen::MatrixXd scaled = lower.selfadjointView<Eigen::Lower>();
  scaled = scale.asDiagonal() * scaled * scale.asDiagonal();
  const Eigen::MatrixXd selected = Eigen::MatrixXd::Identity(lower.rows(), size);
  const Eigen::MatrixXd inverse = scaled.llt().solve(selected).topRows(size);
  return scale.head(size).asDiagonal() * inverse * scale.head(size).asDiagonal();
}

/// Where the unknowns that are sought stand among those of all zooms.
std::vector<Eigen::Index> sought(std::size_t zooms, const BundleOptions& options) {
  std::vector<Eigen::Index> places;
  for (Eigen::Index z = 0; z < static_cast<Eigen::Index>(zooms); ++z)
    for (Eigen::Index i = 0; i < kOfZoom; ++i)
      if (options.coefficients != 5 || i >= 2 * kIntrinsics || i % kIntrinsics < 9)
        places.push_back(z * kOfZoom + i);
  return places;
}

}  // namespace

Eigen::MatrixXd zooms_covariance(ceres::Problem& problem, Unknowns& unknowns,
                                 const BundleOptions& options) {
  ceres::Problem::EvaluateOptions evaluate;
  for (ZoomUnknowns& zoom : unknowns.zooms)
    for (double* block : zoom.blocks()) evaluate.parameter_blocks.push_back(block);
  if (options.is_joint) evaluate.parameter_blocks.push_back(unknowns.bend.data());
  for (auto& pose : unknowns.poses) evaluate.parameter_blocks.push_back(pose.data());
  ceres::CRSMatrix jacobian;
  problem.Evaluate(evaluate, nullptr, nullptr, nullptr, &jacobian);
  const std::vector<Eigen::Index> places = sought(unknowns.zooms.size(), options);
  const auto all = static_cast<Eigen::Index>(unknowns.zooms.size()) * kOfZoom;
  Eigen::MatrixXd covariance = Eigen::MatrixXd::Zero(all, all);
  covariance(places, places) =
      leading_inverse(normal_matrix(jacobian), static_cast<Eigen::Index>(places.size()));
  return covariance;
}

}  // namespace holdfast::registration::bundle
