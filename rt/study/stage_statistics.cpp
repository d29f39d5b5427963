// SPDX-License-Identifier: Apache-2.0
#include "rt/study/stage_statistics.hpp"

#include <algorithm>
#include <cmath>

namespace holdfast::rt {
namespace {

using perception::StageTimes;

struct Stage {
  const char* name;
  std::chrono::nanoseconds StageTimes::*time;
};
constexpr Stage kStages[] = {{"mask", &StageTimes::mask},       {"detect", &StageTimes::detect},
                             {"match", &StageTimes::match},     {"model", &StageTimes::model},
                             {"pyramid", &StageTimes::pyramid}, {"align", &StageTimes::align},
                             {"chain", &StageTimes::chain},     {"check", &StageTimes::check},
                             {"total", &StageTimes::total}};

double at_share(const std::vector<double>& sorted, double share) {
  return sorted[static_cast<std::size_t>(
      std::lround(share * static_cast<double>(sorted.size() - 1)))];
}

}  // namespace

void StageStatistics::add(const StageTimes& times) {
  times_.push_back(times);
}

std::vector<StageTime> StageStatistics::stages() const {
  std::vector<StageTime> stages;
  if (times_.empty()) return stages;
  for (const Stage& stage : kStages) {
    std::vector<double> ms;
    for (const StageTimes& times : times_)
      ms.push_back(static_cast<double>((times.*stage.time).count()) / 1e6);
    std::sort(ms.begin(), ms.end());
    stages.push_back({stage.name, at_share(ms, 0.5), at_share(ms, 0.99), ms.back()});
  }
  return stages;
}

}  // namespace holdfast::rt
