// SPDX-License-Identifier: Apache-2.0
// Virtual hours without any fault, in which every stop is a false one: spread over threads, told of
// as they go on, and kept in a results file from which a later run goes on. An hour is one piece:
// it depends on seed and number alone, so the order and the number of threads change nothing.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "tests/fault/world.hpp"

namespace holdfast::fault {

/// A permission that was lost without any fault.
struct FalseStop {
  std::int64_t ms = 0;  ///< since its hour began
  Observation seen;
};

struct Hour {
  int number = 0;
  std::int64_t ms = 0;  ///< how much of it was run: 3,600,000 but for the last
  std::uint64_t stops = 0;
  std::int64_t first_stop_ms = -1;  ///< -1: none
  std::uint64_t digest = 0;         ///< of all that was decided (tests/fault/digest.hpp)
};

[[nodiscard]] inline WorldOptions lively_room() {
  WorldOptions room;
  room.is_lively = true;
  return room;
}

/// `ms` of one hour in `room`, from when the robot is permitted. `stops`, if there, gets each.
/// Throws InterruptedError when the user wants to end.
[[nodiscard]] Hour run_hour(std::uint64_t seed, int number, std::int64_t ms,
                            const WorldOptions& room = lively_room(),
                            std::vector<FalseStop>* stops = nullptr);

struct HoursOptions {
  std::uint64_t seed = 1;
  double hours = 0;
  int jobs = 1;
  std::string results;       ///< file to keep and to go on from; empty: none
  bool is_progress = false;  ///< a line on stderr every ten seconds
  WorldOptions room = lively_room();
  std::int64_t hour_ms = 3'600'000;  ///< tests take shorter ones
};

struct HoursResult {
  std::vector<Hour> hours;  ///< by number
  std::uint64_t stops = 0;
  double virtual_hours = 0;
  std::uint64_t digest = 0;
  /// Stops an hour that 95 % of such runs would have exceeded (Poisson, one-sided).
  double rate_upper_95 = 0;
};

/// Throws InputError when the results file is none, is of another seed, or of a program that
/// decides otherwise; InterruptedError, with the finished hours in the file.
[[nodiscard]] HoursResult run_hours(const HoursOptions& options);

/// The largest mean for which `count` or fewer events in a Poisson process have 5 % probability.
[[nodiscard]] double poisson_upper_95(std::uint64_t count);

}  // namespace holdfast::fault
