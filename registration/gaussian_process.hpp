// SPDX-License-Identifier: Apache-2.0
// Gaussian process regression for few, noisy evaluations: squared-exponential kernel with a length
// for each input, noise, a constant mean. Lengths, signal and noise are those of the largest
// marginal likelihood times weak priors (found by NLopt), so that five points do not make a length
// of nothing. Pure; no frames; inputs and values in whatever units the caller has.
#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>

namespace holdfast::registration {

/// Natural logarithms, each with a normal prior: centre and standard deviation. Values are first
/// scaled to mean 0 and standard deviation 1, so signal and noise are shares of their scatter.
struct GaussianProcessPriors {
  double log_length_mean = -0.7, log_length_sd = 0.7;
  double log_signal_mean = 0, log_signal_sd = 0.7;
  double log_noise_mean = -2, log_noise_sd = 0.8;
};

class GaussianProcess {
 public:
  /// `inputs`: one row an evaluation; `values`: as many, finite; at least one. Throws
  /// std::invalid_argument otherwise. Deterministic.
  GaussianProcess(Eigen::MatrixXd inputs, const Eigen::VectorXd& values,
                  const GaussianProcessPriors& priors = {});

  struct Prediction {
    double mean = 0;
    double variance = 0;  ///< of the function itself, without the noise of an evaluation; >= 0
  };
  [[nodiscard]] Prediction at(const Eigen::RowVectorXd& input) const;

  [[nodiscard]] Eigen::VectorXd lengths() const {
    return parameters_.head(inputs_.cols()).array().exp();
  }
  [[nodiscard]] double noise_sd() const;  ///< in the values' unit

 private:
  [[nodiscard]] double log_posterior(const Eigen::VectorXd& parameters) const;
  [[nodiscard]] Eigen::MatrixXd covariance(const Eigen::VectorXd& parameters) const;
  void fit();

  Eigen::MatrixXd inputs_;
  Eigen::VectorXd values_;  // scaled
  double centre_ = 0, scale_ = 1;
  GaussianProcessPriors priors_;
  Eigen::VectorXd parameters_;  // log lengths, log signal, log noise
  Eigen::LLT<Eigen::MatrixXd> factor_;
  Eigen::VectorXd weights_;
};

/// How much below `best` a value with this mean and variance is expected to fall (minimisation).
[[nodiscard]] double expected_improvement(const GaussianProcess::Prediction& prediction,
                                          double best);

}  // namespace holdfast::registration
