// SPDX-License-Identifier: Apache-2.0
// The daemon's recorder, where its configuration asks for one: what it is told at the start, and
// what the others hear of it.
#pragma once

#include <memory>

#include "rt/control_step.hpp"
#include "rt/core/clock.hpp"
#include "rt/daemon_config.hpp"
#include "rt/recorder.hpp"

namespace holdfast::rt {

class DaemonRecorder {
 public:
  /// Throws InputError when the folder cannot be written or is in use.
  DaemonRecorder(const DaemonConfig& config, const ControlParameters& parameters);

  /// For the control cycle; null when nothing is recorded.
  [[nodiscard]] CycleTape* tape() noexcept { return recorder_ ? &recorder_->tape() : nullptr; }
  /// not_recording while the disk refuses what was asked for. Any thread.
  [[nodiscard]] safety::ReasonSet advisories() const noexcept;
  /// A line when the disk begins or ceases to refuse, and when cycles were lost. One thread.
  void log_changes();

 private:
  std::unique_ptr<Recorder> recorder_;
  RecorderStatus logged_;
  std::chrono::nanoseconds t_logged_{};
};

}  // namespace holdfast::rt
