// SPDX-License-Identifier: Apache-2.0
#include "registration/gaussian_process.hpp"

#include <cmath>
#include <limits>
#include <numbers>
#include <stdexcept>
#include <utility>
#include <vector>

#include <nlopt.hpp>

namespace holdfast::registration {
namespace {

constexpr double kJitter = 1e-8;  // of the signal: keeps equal inputs invertible

double log_normal(double value, double mean, double sd) {
  const double z = (value - mean) / sd;
  return -0.5 * z * z;
}

}  // namespace

GaussianProcess::GaussianProcess(Eigen::MatrixXd inputs, const Eigen::VectorXd& values,
                                 const GaussianProcessPriors& priors)
    : inputs_(std::move(inputs)), priors_(priors) {
  if (values.size() == 0 || inputs_.rows() != values.size() || !values.allFinite() ||
      !inputs_.allFinite())
    throw std::invalid_argument("Gaussian process: as many finite values as inputs are needed");
  centre_ = values.mean();
  const double sd = std::sqrt((values.array() - centre_).square().mean());
  scale_ = sd > 0 ? sd : 1;
  values_ = (values.array() - centre_) / scale_;
  fit();
}

Eigen::MatrixXd GaussianProcess::covariance(const Eigen::VectorXd& parameters) const {
  const Eigen::Index n = inputs_.rows(), d = inputs_.cols();
  const double signal = std::exp(2 * parameters[d]), noise = std::exp(2 * parameters[d + 1]);
  const Eigen::MatrixXd scaled =
      inputs_ * parameters.head(d).array().exp().inverse().matrix().asDiagonal();
  Eigen::MatrixXd K(n, n);
  for (Eigen::Index i = 0; i < n; ++i)
    for (Eigen::Index j = 0; j <= i; ++j)
      K(i, j) = K(j, i) = signal * std::exp(-0.5 * (scaled.row(i) - scaled.row(j)).squaredNorm());
  K.diagonal().array() += noise + kJitter * signal;
  return K;
}

double GaussianProcess::log_posterior(const Eigen::VectorXd& parameters) const {
  const Eigen::LLT<Eigen::MatrixXd> factor(covariance(parameters));
  if (factor.info() != Eigen::Success) return -std::numeric_limits<double>::max();
  const Eigen::VectorXd weights = factor.solve(values_);
  const Eigen::Index d = inputs_.cols();
  double value = -0.5 * values_.dot(weights) -
                 Eigen::MatrixXd(factor.matrixL()).diagonal().array().log().sum();
  for (Eigen::Index i = 0; i < d; ++i)
    value += log_normal(parameters[i], priors_.log_length_mean, priors_.log_length_sd);
  return value + log_normal(parameters[d], priors_.log_signal_mean, priors_.log_signal_sd) +
         log_normal(parameters[d + 1], priors_.log_noise_mean, priors_.log_noise_sd);
}

void GaussianProcess::fit() {
  const Eigen::Index d = inputs_.cols();
  parameters_ = Eigen::VectorXd::Constant(d + 2, priors_.log_length_mean);
  parameters_[d] = priors_.log_signal_mean;
  parameters_[d + 1] = priors_.log_noise_mean;
  const auto objective = [](const std::vector<double>& p, std::vector<double>& /*gradient*/,
                            void* process) {
    return static_cast<const GaussianProcess*>(process)->log_posterior(
        Eigen::Map<const Eigen::VectorXd>(p.data(), static_cast<Eigen::Index>(p.size())));
  };
  nlopt::opt optimiser(nlopt::LN_BOBYQA, static_cast<unsigned>(d + 2));
  optimiser.set_max_objective(objective, this);
  optimiser.set_lower_bounds(-6);
  optimiser.set_upper_bounds(4);
  optimiser.set_ftol_abs(1e-4);
  optimiser.set_maxeval(300);
  std::vector<double> best(parameters_.data(), parameters_.data() + parameters_.size());
  double value = 0;
  try {
    optimiser.optimize(best, value);
  } catch (const nlopt::roundoff_limited&) {  // what was reached is in `best`
  }
  parameters_ = Eigen::Map<const Eigen::VectorXd>(best.data(), d + 2);
  factor_.compute(covariance(parameters_));
  weights_ = factor_.solve(values_);
}

double GaussianProcess::noise_sd() const {
  return scale_ * std::exp(parameters_[inputs_.cols() + 1]);
}

GaussianProcess::Prediction GaussianProcess::at(const Eigen::RowVectorXd& input) const {
  const Eigen::Index d = inputs_.cols();
  const double signal = std::exp(2 * parameters_[d]);
  const Eigen::RowVectorXd inverse = parameters_.head(d).array().exp().inverse().transpose();
  const Eigen::VectorXd squares =
      ((inputs_.rowwise() - input).array().rowwise() * inverse.array()).square().rowwise().sum();
  const Eigen::VectorXd k = signal * (-0.5 * squares.array()).exp();
  const double variance = signal - k.dot(factor_.solve(k));
  return {centre_ + scale_ * k.dot(weights_), scale_ * scale_ * std::max(variance, 0.0)};
}

double expected_improvement(const GaussianProcess::Prediction& prediction, double best) {
  const double sd = std::sqrt(prediction.variance), gain = best - prediction.mean;
  if (!(sd > 0)) return std::max(gain, 0.0);
  const double z = gain / sd;
  const double density = std::exp(-0.5 * z * z) / std::sqrt(2 * std::numbers::pi);
  return gain * 0.5 * std::erfc(-z / std::numbers::sqrt2) + sd * density;
}

}  // namespace holdfast::registration
