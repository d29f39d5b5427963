// SPDX-License-Identifier: Apache-2.0
// One cycle of the real-time loop: read what has arrived, decide with the control step, hand the
// result on. noexcept, no heap, no locks, no logging, no system call but reading the clocks.
#pragma once

#include <atomic>
#include <cstdint>

#include "rt/control_step.hpp"
#include "rt/core/cyclic_thread.hpp"
#include "rt/core/event_queue.hpp"
#include "rt/core/mailbox.hpp"
#include "rt/core/stop_latch.hpp"
#include "rt/cycle_tape.hpp"
#include "rt/frame_arrivals.hpp"
#include "rt/optics_inbox.hpp"

namespace holdfast::rt {

/// What the publishing thread hears from robot and operator, and the optics thread from the
/// microscope, for the control thread.
struct ControlInbox {
  Mailbox<safety::RobotInput> robot_status;
  EventQueue<safety::OperatorInput, 16> commands;
  OpticsInbox optics;
  std::atomic<bool> message_corrupt{false};   ///< set: a message failed its end-to-end check
  std::atomic<bool> second_publisher{false};  ///< set: another writer of poses is on the domain
};

/// What the control thread did in one cycle, for the publishing thread.
struct CycleReport {
  ControlOutput output;
  safety::Timestamp t_changed{};  ///< when mode or cause last changed
  std::uint64_t cycles = 0;
  std::uint64_t cycles_missed = 0;
  std::chrono::nanoseconds wake_lateness_max{};  ///< since start
  std::chrono::nanoseconds step_max{};           ///< since start
};

class ControlCycle {
 public:
  /// References must outlive it. Reads `arrivals`, `estimates` and `inbox`. Every cycle goes on the
  /// tape, where there is one.
  ControlCycle(const ControlParameters& parameters, const safety::RegistrationInput& registration,
               FrameArrivals& arrivals, Mailbox<StampedEstimate>& estimates, ControlInbox& inbox,
               CycleTape* tape = nullptr);

  /// Control thread only.
  void run(const CycleInfo& info) noexcept;

  /// For the publishing thread: the newest cycle, and the withdrawals that must not be overtaken.
  [[nodiscard]] Mailbox<CycleReport>& reports() noexcept { return reports_; }
  [[nodiscard]] StopLatch& withdrawals() noexcept { return withdrawals_; }

 private:
  void read_inputs(const CycleInfo& info) noexcept;
  [[nodiscard]] safety::Duration clock_divergence() noexcept;
  void account(const CycleInfo& info, const ControlOutput& output) noexcept;

  ControlParameters parameters_;
  FrameArrivals& arrivals_;
  Mailbox<StampedEstimate>& estimates_;
  ControlInbox& inbox_;
  CycleTape* tape_;
  Mailbox<CycleReport> reports_;
  StopLatch withdrawals_;

  Readings readings_;
  ControlState state_;
  CycleReport report_;
  std::uint64_t overflows_seen_ = 0;
  bool has_clock_offset_ = false;
  std::chrono::nanoseconds clock_offset_{};
  std::chrono::nanoseconds clock_offset_doubt_{};
};

}  // namespace holdfast::rt
