// SPDX-License-Identifier: Apache-2.0
// The tracker on a thread of its own: newest sound frame in, stamped estimate out. Beside it, with
// ordinary scheduling, the tracker's check by features (perception/check_thread.hpp) and the live
// view.
#pragma once

#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "rt/control_step.hpp"
#include "rt/core/mailbox.hpp"
#include "rt/daemon_config.hpp"
#include "rt/frame_intake.hpp"
#include "rt/live_view.hpp"

namespace holdfast::rt {

class TrackingThread {
 public:
  using Estimates = Mailbox<StampedEstimate>;

  /// Sets the registration's keyframe and starts. Throws InputError when the keyframe or its depth
  /// cannot be read or cannot serve, and as LiveView. `intake` must outlive it.
  TrackingThread(const DaemonConfig& config, FrameIntake& intake);
  ~TrackingThread();
  TrackingThread(const TrackingThread&) = delete;
  TrackingThread& operator=(const TrackingThread&) = delete;

  /// One reader thread each.
  [[nodiscard]] Estimates& for_control() noexcept { return for_control_; }
  [[nodiscard]] Estimates& for_publishing() noexcept { return for_publishing_; }
  [[nodiscard]] const std::vector<std::string>& warnings() const noexcept { return warnings_; }
  /// The errno that keeps the live view from being written; 0: nothing does. Any thread.
  [[nodiscard]] int live_view_error() const noexcept { return live_ ? live_->error() : 0; }

 private:
  FrameIntake& intake_;
  Estimates for_control_;
  Estimates for_publishing_;
  std::vector<std::string> warnings_;
  std::optional<LiveView> live_;  // used by the thread
  std::thread thread_;
};

}  // namespace holdfast::rt
