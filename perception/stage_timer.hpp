// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>

namespace holdfast::perception {

/// Adds the wall time from its construction to the end of its scope to a stage's time.
class StageTimer {
 public:
  explicit StageTimer(std::chrono::nanoseconds& stage)
      : stage_(stage), start_(std::chrono::steady_clock::now()) {}
  ~StageTimer() { stage_ += std::chrono::steady_clock::now() - start_; }
  StageTimer(const StageTimer&) = delete;
  StageTimer& operator=(const StageTimer&) = delete;

 private:
  std::chrono::nanoseconds& stage_;
  std::chrono::steady_clock::time_point start_;
};

}  // namespace holdfast::perception
