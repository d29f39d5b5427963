// SPDX-License-Identifier: Apache-2.0
// Which dots to try next (paper A, "Adaptive pattern generator"): a Gaussian process over the
// logarithms of pitch and dot size, expected improvement over all patterns there are. Pure: values
// come in, proposals go out; projecting, reconstructing and judging are the caller's.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "registration/dots.hpp"
#include "registration/gaussian_process.hpp"

namespace holdfast::registration {

/// One pattern and how bad it was (> 0, less is better; mm in practice).
struct DotsValue {
  Dots dots;
  double value = 0;
};

struct PatternSearchOptions {
  /// Paper A: ten random patterns, then improvement on the best value seen. Else: five patterns
  /// that spread over the range, or, where there is a neighbour, its best; then improvement on the
  /// best mean that the process knows.
  bool is_paper = false;
  int random_first = 10;  ///< paper A
  int spread_first = 5;
  std::uint64_t seed = 1;
  /// What a neighbouring zoom found: its values shape the expectation here. May be empty.
  std::vector<DotsValue> neighbour;
  int evaluations_max = 25;
  double improvement_min = 0.01;  ///< expected, of the best value: less ends the search
};

class PatternSearch {
 public:
  explicit PatternSearch(PatternSearchOptions options);

  /// What to evaluate next; empty when the search is over. Does not change the search.
  [[nodiscard]] std::optional<Dots> next() const;
  /// Any pattern, proposed or not; the same one again is a second, noisy evaluation.
  /// Throws std::invalid_argument on a value that is not positive and finite.
  void add(const DotsValue& evaluation);

  /// The best: by the process's mean among what was evaluated (paper A: the least value seen).
  /// Precondition: something was added.
  [[nodiscard]] DotsValue best() const;
  [[nodiscard]] const std::vector<DotsValue>& evaluations() const { return evaluations_; }

 private:
  [[nodiscard]] std::optional<Dots> initial() const;
  [[nodiscard]] std::optional<Dots> by_improvement() const;
  [[nodiscard]] double expected_log(const Dots& dots) const;

  PatternSearchOptions options_;
  std::vector<Dots> first_;
  std::optional<GaussianProcess> neighbour_;
  std::optional<GaussianProcess> process_;  // of what the neighbour does not explain
  std::vector<DotsValue> evaluations_;
};

}  // namespace holdfast::registration
