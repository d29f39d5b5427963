// SPDX-License-Identifier: Apache-2.0
// Runs of the world under a fault, and what the oracle says of them.
#pragma once

#include <string>
#include <vector>

#include "tests/fault/classes.hpp"

namespace holdfast::fault {

struct RunResult {
  int over_limit_max_ms = 0;  ///< longest permission in a row with the true error over its limit
  double error_max_mm = 0;    ///< largest true error while permitted
  int reaction_ms = -1;       ///< fault to robot off; -1: it never was off
  /// The gate's first decision to withhold to robot off, what is left of the millisecond of the
  /// decision counting as one; -1: the robot was off before, or the gate never withheld.
  int withheld_to_off_ms = -1;
  std::uint64_t digest = 0;  ///< of all that was decided (tests/fault/digest.hpp)
  [[nodiscard]] bool is_hazard(const FaultClass& fault) const {
    return over_limit_max_ms > fault.over_limit_max_ms;
  }
  [[nodiscard]] bool is_late(const FaultClass& fault) const {
    return fault.reaction_max_ms > 0 && (reaction_ms < 0 || reaction_ms > fault.reaction_max_ms);
  }
};

/// A world that has been permitted for a while, from which runs start. Throws RefusedError when it
/// never is.
[[nodiscard]] World permitted_world(const WorldOptions& options, std::uint64_t seed = 1);

/// One run: the world goes on for a random part of two frames, then the fault stands for
/// `fault_ms`. The same seed gives the same result.
[[nodiscard]] RunResult run_fault(const World& permitted, const FaultClass& fault,
                                  std::uint64_t seed, int fault_ms = 400);

/// The seed of run `run` of class number `index`: what a failure prints and --replay takes.
[[nodiscard]] std::uint64_t run_seed(std::uint64_t seed, std::size_t index, int run);

/// True when some run of some class under this bug is a hazard or late, without the guard: what one
/// layer misses the other must not be needed for.
[[nodiscard]] bool finds(Bug bug, std::uint64_t seed, int runs_per_class, std::string& by);

}  // namespace holdfast::fault
