// SPDX-License-Identifier: Apache-2.0
#include "tests/fault/campaign.hpp"

#include <algorithm>

#include "rt/core/error.hpp"
#include "tests/fault/digest.hpp"

namespace holdfast::fault {

World permitted_world(const WorldOptions& options, std::uint64_t seed) {
  World world(seed, options);
  int permitted_ms = 0;
  for (int ms = 0; ms < 5000 && permitted_ms < 300; ++ms)
    permitted_ms = world.step().is_permitted ? permitted_ms + 1 : 0;
  if (permitted_ms < 300) throw RefusedError("campaign: the healthy world is never permitted");
  return world;
}

RunResult run_fault(const World& permitted, const FaultClass& fault, std::uint64_t seed,
                    int fault_ms) {
  World world = permitted;
  world.reseed(seed);
  const int lead_ms = static_cast<int>(world.uniform(0, 67));
  for (int ms = 0; ms < lead_ms; ++ms) (void)world.step();
  fault.disturb(world);
  RunResult result;
  Digest digest;
  int over_ms = 0, withheld_ms = 0;
  for (int ms = 1; ms <= fault_ms; ++ms) {
    const Observation seen = world.step();
    digest.add(seen);
    if (seen.is_withheld && withheld_ms == 0) withheld_ms = ms;
    if (!seen.is_permitted && result.reaction_ms < 0) {
      result.reaction_ms = ms;
      if (withheld_ms > 0) result.withheld_to_off_ms = ms - withheld_ms + 1;
    }
    over_ms = seen.is_permitted && !(seen.error_mm <= kErrorLimitMm) ? over_ms + 1 : 0;
    result.over_limit_max_ms = std::max(result.over_limit_max_ms, over_ms);
    if (seen.is_permitted) result.error_max_mm = std::max(result.error_max_mm, seen.error_mm);
  }
  result.digest = digest.value();
  return result;
}

std::uint64_t run_seed(std::uint64_t seed, std::size_t index, int run) {
  // SplitMix64, so that neighbours share nothing.
  std::uint64_t z =
      seed * 0x9E3779B97F4A7C15U + index * 1'000'003U + static_cast<std::uint64_t>(run);
  z = (z ^ (z >> 30U)) * 0xBF58476D1CE4E5B9U;
  z = (z ^ (z >> 27U)) * 0x94D049BB133111EBU;
  return z ^ (z >> 31U);
}

bool finds(Bug bug, std::uint64_t seed, int runs_per_class, std::string& by) {
  WorldOptions options;
  options.has_guard = false;
  options.bug = bug;
  const World permitted = permitted_world(options);
  for (std::size_t i = 0; i < fault_classes().size(); ++i) {
    const FaultClass& fault = fault_classes()[i];
    if (fault.is_of_guard) continue;
    for (int run = 0; run < runs_per_class; ++run) {
      const RunResult result = run_fault(permitted, fault, run_seed(seed, i, run));
      if (!result.is_hazard(fault) && !result.is_late(fault)) continue;
      by = fault.name;
      return true;
    }
  }
  return false;
}

}  // namespace holdfast::fault
