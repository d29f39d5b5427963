// SPDX-License-Identifier: Apache-2.0
// The recorder: takes the control thread's tape and writes it as MCAP files, on a thread of its own
// with ordinary scheduling. A file is readable after whatever ends the daemon, up to the last
// quarter of a second; after a loss of power, up to the last second. What the disk refuses is
// counted and published, and disturbs nothing else. docs/recording.md
#pragma once

#include <cstdint>
#include <memory>

#include "bridge/recorder/segment_folder.hpp"
#include "rt/cycle_tape.hpp"
#include "rt/recorder_config.hpp"
#include "rt/recording.hpp"

namespace holdfast::rt {

enum class RecorderCondition : std::uint8_t {
  recording,
  disk_full,    ///< nothing is left to delete; tried again once a second
  write_failed  ///< likewise; RecorderStatus::error says what the disk said
};
[[nodiscard]] std::string_view name(RecorderCondition condition) noexcept;

struct RecorderStatus {
  RecorderCondition condition = RecorderCondition::recording;
  int error = 0;               ///< errno of the newest failure
  std::uint64_t taken = 0;     ///< cycles up to the newest taken from the tape
  std::uint64_t recorded = 0;  ///< cycles that are in a file
  std::uint64_t lost = 0;      ///< cycles that are in none: the disk refused, or the tape was full
};

class Recorder {
 public:
  /// Begins the first file. `session.run` names the files, `part` is set here. Throws InputError
  /// when the folder cannot be written or is in use.
  Recorder(const RecorderConfig& config, const RecordedSession& session,
           bridge::SegmentFolder::Write write = nullptr);
  /// Writes what is on the tape, then closes the file. The control thread must have ended.
  ~Recorder();
  Recorder(const Recorder&) = delete;
  Recorder& operator=(const Recorder&) = delete;

  /// The control thread records on it, from cycle 0 on.
  [[nodiscard]] CycleTape& tape() noexcept;
  /// Any thread; wait-free.
  [[nodiscard]] RecorderStatus status() const noexcept;

 private:
  class Thread;
  std::unique_ptr<Thread> thread_;
};

}  // namespace holdfast::rt
