// SPDX-License-Identifier: Apache-2.0
// The fault classes of the campaign: how each disturbs the world, and what is declared about it.
#pragma once

#include <span>

#include "tests/fault/world.hpp"

namespace holdfast::fault {

struct FaultClass {
  const char* name;
  const char* group;
  /// Longest time for which the robot may be permitted while the true error exceeds the limit.
  int over_limit_max_ms;
  /// The robot must be off this long after the fault began; 0: it may go on, if it is right.
  int reaction_max_ms;
  void (*disturb)(World& world);
  bool is_of_guard = false;  ///< the guard's own: always with it
};

/// Declared for all: the true error at the target that a permitted robot may have, three times the
/// largest sigma that the gate lets pass.
inline constexpr double kErrorLimitMm = 0.75;

[[nodiscard]] std::span<const FaultClass> fault_classes();

}  // namespace holdfast::fault
