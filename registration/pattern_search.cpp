// SPDX-License-Identifier: Apache-2.0
#include "registration/pattern_search.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <random>
#include <stdexcept>
#include <utility>

namespace holdfast::registration {
namespace {

Eigen::RowVectorXd input_of(const Dots& dots) {
  return Eigen::RowVector2d(std::log(dots.distance_px + dots.dot_px), std::log(dots.dot_px));
}

GaussianProcess process_of(const std::vector<DotsValue>& evaluations,
                           const GaussianProcess* explained) {
  Eigen::MatrixXd inputs(static_cast<Eigen::Index>(evaluations.size()), 2);
  Eigen::VectorXd values(inputs.rows());
  for (Eigen::Index i = 0; i < inputs.rows(); ++i) {
    const DotsValue& evaluation = evaluations[static_cast<std::size_t>(i)];
    inputs.row(i) = input_of(evaluation.dots);
    values[i] = std::log(evaluation.value);
    if (explained != nullptr) values[i] -= explained->at(inputs.row(i)).mean;
  }
  return {std::move(inputs), values};
}

/// The same on every standard library.
std::vector<Dots> shuffled(std::uint64_t seed) {
  std::vector<Dots> dots(all_dots().begin(), all_dots().end());
  std::mt19937_64 random(seed);
  for (std::size_t i = dots.size(); i > 1; --i) std::swap(dots[i - 1], dots[random() % i]);
  return dots;
}

}  // namespace

PatternSearch::PatternSearch(PatternSearchOptions options) : options_(std::move(options)) {
  if (options_.is_paper) {
    first_ = shuffled(options_.seed);
    first_.resize(static_cast<std::size_t>(options_.random_first));
    return;
  }
  if (!options_.neighbour.empty()) {
    neighbour_.emplace(process_of(options_.neighbour, nullptr));
    first_ = {
        std::min_element(options_.neighbour.begin(), options_.neighbour.end(),
                         [](const DotsValue& a, const DotsValue& b) { return a.value < b.value; })
            ->dots};
    return;
  }
  // Each as far as can be, in the process's inputs, from those before; the seed picks the first.
  const std::vector<Dots> dots = shuffled(options_.seed);
  first_ = {dots[0]};
  while (static_cast<int>(first_.size()) < options_.spread_first) {
    const auto room = [this](const Dots& candidate) {
      double nearest = 1e9;
      for (const Dots& taken : first_)
        nearest = std::min(nearest, (input_of(candidate) - input_of(taken)).squaredNorm());
      return nearest;
    };
    first_.push_back(*std::max_element(
        dots.begin(), dots.end(), [&](const Dots& a, const Dots& b) { return room(a) < room(b); }));
  }
}

std::optional<Dots> PatternSearch::initial() const {
  for (const Dots& dots : first_) {
    const bool is_done =
        std::any_of(evaluations_.begin(), evaluations_.end(),
                    [&](const DotsValue& evaluation) { return evaluation.dots == dots; });
    if (!is_done) return dots;
  }
  return {};
}

double PatternSearch::expected_log(const Dots& dots) const {
  const Eigen::RowVectorXd input = input_of(dots);
  return process_->at(input).mean + (neighbour_ ? neighbour_->at(input).mean : 0);
}

std::optional<Dots> PatternSearch::by_improvement() const {
  const auto log_of = [this](const DotsValue& evaluation) {
    return options_.is_paper ? std::log(evaluation.value) : expected_log(evaluation.dots);
  };
  double best = log_of(evaluations_.front());
  for (const DotsValue& evaluation : evaluations_) best = std::min(best, log_of(evaluation));
  std::optional<Dots> choice;
  double most = std::log1p(options_.improvement_min);
  for (const Dots& dots : all_dots()) {
    GaussianProcess::Prediction prediction = process_->at(input_of(dots));
    prediction.mean = expected_log(dots);
    const double improvement = expected_improvement(prediction, best);
    if (improvement <= most) continue;
    most = improvement;
    choice = dots;
  }
  return choice;
}

std::optional<Dots> PatternSearch::next() const {
  if (static_cast<int>(evaluations_.size()) >= options_.evaluations_max) return {};
  if (const auto dots = initial()) return dots;
  return by_improvement();
}

void PatternSearch::add(const DotsValue& evaluation) {
  if (!(evaluation.value > 0) || !std::isfinite(evaluation.value))
    throw std::invalid_argument("pattern search: a value must be positive and finite");
  evaluations_.push_back(evaluation);
  process_.emplace(process_of(evaluations_, neighbour_ ? &*neighbour_ : nullptr));
}

DotsValue PatternSearch::best() const {
  const auto worth = [this](const DotsValue& evaluation) {
    return options_.is_paper ? evaluation.value : expected_log(evaluation.dots);
  };
  return *std::min_element(
      evaluations_.begin(), evaluations_.end(),
      [&](const DotsValue& a, const DotsValue& b) { return worth(a) < worth(b); });
}

}  // namespace holdfast::registration
