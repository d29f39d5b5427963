// SPDX-License-Identifier: Apache-2.0
// Every state that the real gate can reach, by breadth-first search over (state, input): times are
// whole ticks, limits a few ticks, and every condition that an input can carry is set and not set.
// An observer who sees inputs and decisions only, never the gate's state, says what may be.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "safety/gate.hpp"

namespace holdfast::safety::test {

/// The gate under test: the real one, or the real one behind a seeded bug.
using Decide = Decision (*)(const Limits&, const Inputs&, GateState&) noexcept;

inline constexpr Duration kTick = std::chrono::milliseconds(1);

/// Limits of a few ticks each, so that every age at, below and beyond them is reached.
[[nodiscard]] Limits small_limits();

/// What the observer knows. Ages are in ticks before now, capped where no limit looks further back.
struct Observer {
  Mode mode = Mode::init;
  std::optional<int> acknowledged;          ///< a valid first step, for this stop
  std::optional<int> hold_entered, unwell;  ///< newest cycle with anything wrong
  std::optional<int> doubted;               ///< newest cycle with the optics in doubt
  std::optional<int> registered;            ///< since when this registration is loaded
  bool is_verified = false;
  bool has_cycle = false;  ///< there was one: from now on time cannot go back
  friend auto operator<=>(const Observer&, const Observer&) = default;
};

struct Enumeration {
  std::size_t states = 0, inputs = 0, transitions = 0;
  std::map<std::pair<Mode, Mode>, std::size_t> mode_changes;
  /// Merged states of which another representative was tried and behaved the same.
  std::size_t merged_and_compared = 0;
  std::string violation;  ///< the first one; empty: none
};

/// Explores until nothing new is reached or something is violated.
[[nodiscard]] Enumeration enumerate(Decide decide);

}  // namespace holdfast::safety::test
