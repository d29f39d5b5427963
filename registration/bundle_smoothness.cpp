// SPDX-License-Identifier: Apache-2.0
#include "registration/bundle_smoothness.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <Eigen/QR>
#include <ceres/cost_function.h>

#include "registration/bundle_priors.hpp"

namespace holdfast::registration::bundle {
namespace {

/// What of one block a parabola over zoom does not explain: sum_z contrast(z) · block_z / sigma.
class SmoothResidual : public ceres::CostFunction {
 public:
  SmoothResidual(Eigen::VectorXd contrast, Eigen::VectorXd sigma)
      : contrast_(std::move(contrast)), sigma_(std::move(sigma)) {
    set_num_residuals(static_cast<int>(sigma_.size()));
    for (Eigen::Index z = 0; z < contrast_.size(); ++z)
      mutable_parameter_block_sizes()->push_back(static_cast<int>(sigma_.size()));
  }
  bool Evaluate(double const* const* blocks, double* residuals, double** jacobians) const override {
    const Eigen::Index n = sigma_.size();
    Eigen::Map<Eigen::VectorXd> residual(residuals, n);
    residual.setZero();
    for (Eigen::Index z = 0; z < contrast_.size(); ++z) {
      residual += contrast_[z] * Eigen::Map<const Eigen::VectorXd>(blocks[z], n);
      if (jacobians == nullptr || jacobians[z] == nullptr) continue;
      Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>> jacobian(
          jacobians[z], n, n);
      jacobian = (contrast_[z] * sigma_.cwiseInverse()).asDiagonal();
    }
    residual.array() /= sigma_.array();
    return true;
  }

 private:
  Eigen::VectorXd contrast_, sigma_;
};

Eigen::VectorXd vector_of(const ZoomUnknowns& zoom) {
  Eigen::VectorXd vector(kOfZoom);
  vector << Eigen::Map<const Eigen::VectorXd>(zoom.left.data(), kIntrinsics),
      Eigen::Map<const Eigen::VectorXd>(zoom.right.data(), kIntrinsics),
      Eigen::Map<const Eigen::VectorXd>(zoom.extrinsics.data(), kExtrinsics);
  return vector;
}

/// Expected squares of what `contrast` finds in each parameter.
Eigen::VectorXd expected_squares(const std::vector<ZoomUnknowns>& zooms,
                                 const Eigen::MatrixXd& covariance,
                                 const Eigen::VectorXd& contrast) {
  Eigen::VectorXd deviation = Eigen::VectorXd::Zero(kOfZoom);
  Eigen::VectorXd variance = Eigen::VectorXd::Zero(kOfZoom);
  for (Eigen::Index z = 0; z < contrast.size(); ++z) {
    deviation += contrast[z] * vector_of(zooms[static_cast<std::size_t>(z)]);
    for (Eigen::Index y = 0; y < contrast.size(); ++y)
      variance += contrast[z] * contrast[y] *
                  covariance.block(z * kOfZoom, y * kOfZoom, kOfZoom, kOfZoom).diagonal();
  }
  return deviation.cwiseAbs2() + variance;
}

}  // namespace

Eigen::MatrixXd contrasts(const std::vector<ZoomViews>& views) {
  const auto n = static_cast<Eigen::Index>(views.size());
  if (n < 4) return Eigen::MatrixXd::Zero(n, 0);
  Eigen::MatrixXd powers(n, 3);
  for (Eigen::Index i = 0; i < n; ++i) {
    const double x =
        std::log(views[static_cast<std::size_t>(i)].zoom) - std::log(views.front().zoom);
    powers.row(i) << 1, x, x * x;
  }
  const Eigen::HouseholderQR<Eigen::MatrixXd> qr(powers);
  const Eigen::MatrixXd q = qr.householderQ() * Eigen::MatrixXd::Identity(n, n);
  return q.rightCols(n - 3);
}

Eigen::VectorXd first_smooth_sigma(const ZoomUnknowns& zoom, cv::Size image,
                                   const BundleOptions& options) {
  Eigen::VectorXd sigma(kOfZoom);
  for (const int side : {0, 1}) {
    const Prior prior = camera_prior(side == 0 ? zoom.left : zoom.right, image, options);
    for (int i = 0; i < kIntrinsics; ++i)
      sigma[side * kIntrinsics + i] =
          i < 2 ? 0.02 : (i < 4 ? 20 : 0.3 * prior.sigma[static_cast<std::size_t>(i)]);
  }
  sigma.segment(2 * kIntrinsics, 3).setConstant(5e-3);
  sigma.segment(2 * kIntrinsics + 3, 3).setConstant(1);
  return sigma;
}

void add_smoothness(ceres::Problem& problem, Unknowns& unknowns, const Eigen::MatrixXd& contrasts,
                    const Eigen::VectorXd& sigma) {
  constexpr std::array<Eigen::Index, 3> kSizes = {kIntrinsics, kIntrinsics, kExtrinsics};
  for (Eigen::Index k = 0; k < contrasts.cols(); ++k) {
    Eigen::Index at = 0;
    for (std::size_t b = 0; b < kSizes.size(); ++b) {
      std::vector<double*> of_zooms;
      for (ZoomUnknowns& zoom : unknowns.zooms) of_zooms.push_back(zoom.blocks().at(b));
      problem.AddResidualBlock(new SmoothResidual(contrasts.col(k), sigma.segment(at, kSizes[b])),
                               nullptr, of_zooms);
      at += kSizes[b];
    }
  }
}

double learn_smoothness(const std::vector<ZoomUnknowns>& zooms, const Eigen::MatrixXd& covariance,
                        const Eigen::MatrixXd& contrasts, Eigen::VectorXd& sigma) {
  if (contrasts.cols() == 0) return 0;
  Eigen::VectorXd squares = Eigen::VectorXd::Zero(kOfZoom);
  for (Eigen::Index k = 0; k < contrasts.cols(); ++k)
    squares += expected_squares(zooms, covariance, contrasts.col(k));
  const double count = static_cast<double>(contrasts.cols());
  Eigen::VectorXd learnt(kOfZoom);
  for (Eigen::Index i = 0; i < kIntrinsics; ++i) {  // both cameras are of one make
    const double both = squares[i] + squares[kIntrinsics + i];
    learnt[i] = learnt[kIntrinsics + i] = std::sqrt(both / (2 * count));
  }
  for (Eigen::Index i = 2 * kIntrinsics; i < kOfZoom; ++i)
    learnt[i] = std::sqrt(squares[i] / count);
  double change = 0;
  for (Eigen::Index i = 0; i < kOfZoom; ++i) {
    learnt[i] = std::max(learnt[i], 1e-3 * sigma[i]);  // a lucky zero would lock it
    change = std::max(change, std::abs(std::log(learnt[i] / sigma[i])));
  }
  sigma = learnt;
  return change;
}

}  // namespace holdfast::registration::bundle
