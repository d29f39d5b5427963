// SPDX-License-Identifier: Apache-2.0
// The Gaussian process against what is known of it, and the search on functions whose best is
// known, against random search.
#include "registration/pattern_search.hpp"

#include <algorithm>
#include <cmath>
#include <random>
#include <stdexcept>
#include <vector>

#include <gtest/gtest.h>

namespace holdfast::registration {
namespace {

TEST(GaussianProcess, PassesThroughExactValuesAndIsUncertainBetween) {
  Eigen::MatrixXd inputs(6, 1);
  inputs << 0, 0.4, 0.8, 1.2, 1.6, 2.0;
  const Eigen::VectorXd values = (2 * inputs.array()).sin().matrix();
  const GaussianProcess process(inputs, values);
  for (Eigen::Index i = 0; i < inputs.rows(); ++i)
    EXPECT_NEAR(process.at(inputs.row(i)).mean, values[i], 0.1);
  const auto between = process.at(Eigen::RowVectorXd::Constant(1, 1.0));
  EXPECT_NEAR(between.mean, std::sin(2.0), 0.1);
  const auto far = process.at(Eigen::RowVectorXd::Constant(1, 30.0));
  EXPECT_NEAR(far.mean, values.mean(), 1e-6);
  EXPECT_GT(far.variance, 10 * between.variance);
}

TEST(GaussianProcess, FindsWhichInputMattersAndHowLargeTheNoiseIs) {
  std::mt19937_64 random(3);
  std::normal_distribution<double> noise(0, 0.1);
  std::uniform_real_distribution<double> place(0, 2);
  Eigen::MatrixXd inputs(60, 2);
  Eigen::VectorXd values(60);
  for (Eigen::Index i = 0; i < 60; ++i) {
    inputs.row(i) << place(random), place(random);
    values[i] = std::sin(3 * inputs(i, 0)) + noise(random);
  }
  const GaussianProcess process(inputs, values);
  EXPECT_GT(process.lengths()[1], 2 * process.lengths()[0]);
  EXPECT_NEAR(process.noise_sd(), 0.1, 0.04);
}

TEST(GaussianProcess, RefusesWhatIsNoData) {
  EXPECT_THROW(GaussianProcess(Eigen::MatrixXd(0, 2), Eigen::VectorXd(0)), std::invalid_argument);
  EXPECT_THROW(GaussianProcess(Eigen::MatrixXd::Zero(2, 1), Eigen::VectorXd::Constant(2, NAN)),
               std::invalid_argument);
}

TEST(ExpectedImprovement, IsTheClosedForm) {
  EXPECT_NEAR(expected_improvement({1, 0}, 3), 2, 1e-12);
  EXPECT_EQ(expected_improvement({3, 0}, 1), 0);
  EXPECT_NEAR(expected_improvement({0, 4}, 0), 2 / std::sqrt(2 * M_PI), 1e-12);
  EXPECT_GT(expected_improvement({0, 9}, 0), expected_improvement({0, 4}, 0));
}

/// Like what is measured: a valley in pitch and size, its bottom 0.1 mm, 5 % noise.
struct Valley {
  double pitch_px = 9, dot_px = 4;
  double operator()(const Dots& dots) const {
    const double u = std::log((dots.distance_px + dots.dot_px) / pitch_px);
    const double v = std::log(dots.dot_px / dot_px);
    return 0.1 * std::exp(std::min(1.2 * u * u + 0.7 * v * v - 0.4 * u * v, 3.0));
  }
  [[nodiscard]] double least() const {
    double least = 1e9;
    for (const Dots& dots : all_dots()) least = std::min(least, (*this)(dots));
    return least;
  }
};

/// Evaluations until the pattern that would be taken is within 5 % of the best there is.
int evaluations_needed(const Valley& valley, PatternSearchOptions options) {
  options.evaluations_max = 60;
  options.improvement_min = 0;
  PatternSearch search(options);
  std::mt19937_64 random(options.seed + 100);
  std::normal_distribution<double> noise(0, 0.05);
  for (int i = 1; i <= options.evaluations_max; ++i) {
    const auto dots = search.next();
    if (!dots) break;
    search.add({*dots, valley(*dots) * std::exp(noise(random))});
    if (i > 2 && valley(search.best().dots) <= 1.05 * valley.least()) return i;
  }
  return options.evaluations_max;
}

int random_needed(const Valley& valley, std::uint64_t seed) {
  std::mt19937_64 random(seed);
  for (int i = 1;; ++i)
    if (valley(all_dots()[random() % all_dots().size()]) <= 1.05 * valley.least()) return i;
}

int median(std::vector<int> values) {
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}

TEST(PatternSearch, NeedsFewerEvaluationsThanChanceAndFewerStillWithANeighbour) {
  const Valley valley, before{8, 3.5};
  std::vector<int> ours, paper, after, chance;
  for (std::uint64_t seed = 1; seed <= 15; ++seed) {
    PatternSearchOptions options;
    options.seed = seed;
    ours.push_back(evaluations_needed(valley, options));
    options.is_paper = true;
    paper.push_back(evaluations_needed(valley, options));
    options.is_paper = false;
    for (std::size_t i = seed; i < all_dots().size(); i += 15)
      options.neighbour.push_back({all_dots()[i], before(all_dots()[i])});
    after.push_back(evaluations_needed(valley, options));
    chance.push_back(random_needed(valley, seed));
  }
  RecordProperty("first_zoom", median(ours));
  RecordProperty("next_zoom", median(after));
  RecordProperty("paper_mode", median(paper));
  RecordProperty("random", median(chance));
  EXPECT_LE(median(ours), 15);
  EXPECT_LE(median(after), 10);
  EXPECT_LE(median(ours), median(paper));
  EXPECT_LT(median(ours), median(chance));
}

TEST(PatternSearch, EndsByItselfAndRepeatsItself) {
  const auto run = [](std::uint64_t seed) {
    PatternSearchOptions options;
    options.seed = seed;
    PatternSearch search(options);
    while (const auto dots = search.next()) search.add({*dots, Valley{}(*dots)});
    return search.evaluations();
  };
  const auto one = run(5), two = run(5), other = run(6);
  EXPECT_LT(one.size(), 25U);
  ASSERT_EQ(one.size(), two.size());
  for (std::size_t i = 0; i < one.size(); ++i) EXPECT_EQ(one[i].dots, two[i].dots);
  EXPECT_FALSE(one[0].dots == other[0].dots);
}

TEST(PatternSearch, PaperModeBeginsWithTenPatternsNoneTwice) {
  PatternSearchOptions options;
  options.is_paper = true;
  PatternSearch search(options);
  std::vector<Dots> seen;
  for (int i = 0; i < 10; ++i) {
    const auto dots = search.next();
    ASSERT_TRUE(dots);
    EXPECT_EQ(std::count(seen.begin(), seen.end(), *dots), 0);
    seen.push_back(*dots);
    search.add({*dots, 1.0 + 0.1 * i});
  }
  EXPECT_EQ(search.best().value, 1.0);
}

TEST(PatternSearch, RefusesWhatIsNoValue) {
  PatternSearch search({});
  EXPECT_THROW(search.add({{1, 2}, 0.0}), std::invalid_argument);
  EXPECT_THROW(search.add({{1, 2}, NAN}), std::invalid_argument);
}

}  // namespace
}  // namespace holdfast::registration
