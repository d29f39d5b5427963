// SPDX-License-Identifier: Apache-2.0
// Replays recordings through the control step and compares every decision and state with what was
// recorded, bit for bit. What cannot be compared is counted and said: cycles that are missing, and
// those up to the next recorded state. docs/recording.md
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "rt/recording.hpp"

namespace holdfast::rt {

/// The first decision or state that the replay does not reproduce.
struct ReplayDifference {
  std::filesystem::path file;
  std::uint64_t cycle = 0;
  std::string field, recorded, replayed;  ///< its first field that differs, and both values
};

/// A file that ends before its writer closed it.
struct ReplayCut {
  std::filesystem::path file;
  std::uint64_t at_byte = 0;  ///< where its whole part ends
  std::uint64_t bytes = 0;    ///< of a record that is not whole; 0 when it ends between two
};

struct ReplayReport {
  std::uint64_t files = 0, runs = 0;
  std::uint64_t cycles = 0;         ///< that are recorded
  std::uint64_t compared = 0;       ///< decisions
  std::uint64_t states = 0;         ///< compared likewise
  std::uint64_t without_state = 0;  ///< cycles before the first state after a gap: not compared
  std::uint64_t differences = 0;    ///< decisions and states
  std::uint64_t missing = 0;        ///< cycles that the recorder lost
  std::vector<RecordedGap> gaps;    ///< where; the first kGapsMax
  std::vector<ReplayCut> cuts;
  std::optional<ReplayDifference> first_difference;
  std::chrono::nanoseconds recorded{};  ///< from first to last decision, runs added up

  static constexpr std::size_t kGapsMax = 100;
};

/// What may be watched while it runs; each may be empty.
struct ReplayWatch {
  /// Each compared cycle, in order: its input and the decision that the replay made. With it the
  /// files are replayed one after another.
  std::function<void(const RecordedInput&, const ControlOutput&)> on_cycle;
  /// Before each file.
  std::function<void(const std::filesystem::path&)> on_file;
  /// Asked now and then; true ends the replay with InterruptedError.
  std::function<bool()> is_interrupted;
};

/// `files` in the order of their recording, as many at a time as there are processors: each begins
/// with a recorded state, and must lead to the one that the next begins with. Throws InputError on
/// a file that is damaged, no recording, or of a version whose messages are others.
[[nodiscard]] ReplayReport replay(const std::vector<std::filesystem::path>& files,
                                  const ReplayWatch& watch = {});

}  // namespace holdfast::rt
