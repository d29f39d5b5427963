// SPDX-License-Identifier: Apache-2.0
// How long the stages of tracking took, over a sequence.
#pragma once

#include <string>
#include <vector>

#include "perception/motion_estimate.hpp"

namespace holdfast::rt {

struct StageTime {
  std::string name;  ///< mask, detect, ..., total
  double median_ms = 0, p99_ms = 0, max_ms = 0;
};

class StageStatistics {
 public:
  void add(const perception::StageTimes& times);
  /// In the order of the work, "total" last. Zero for a stage that the method has not. Empty
  /// without a frame.
  [[nodiscard]] std::vector<StageTime> stages() const;

 private:
  std::vector<perception::StageTimes> times_;
};

}  // namespace holdfast::rt
