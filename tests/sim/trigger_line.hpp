// SPDX-License-Identifier: Apache-2.0
// The wire that starts the exposures of several virtual cameras at one instant: what a trigger
// generator, or a strobe output, is in the operating room.
#pragma once

#include <array>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <optional>
#include <thread>

namespace holdfast::sim {

/// Any thread may call anything.
class TriggerLine {
 public:
  struct Pulse {
    std::uint64_t number = 0;      ///< from 1
    std::chrono::nanoseconds t{};  ///< its rising edge, CLOCK_MONOTONIC
  };

  /// A rising edge, now.
  Pulse fire();
  /// The newest pulse if it is newer than number `seen`; waits up to `timeout` for one.
  [[nodiscard]] std::optional<Pulse> wait_after(std::uint64_t seen,
                                                std::chrono::microseconds timeout);
  /// The number of the last pulse at or before `t`; 0 when there was none, or longer ago than the
  /// last 64 pulses.
  [[nodiscard]] std::uint64_t number_at(std::chrono::nanoseconds t) const;

 private:
  mutable std::mutex mutex_;
  std::condition_variable fired_;
  Pulse newest_;
  std::array<Pulse, 64> recent_{};
};

/// Fires at a fixed rate, from construction to destruction.
class TriggerGenerator {
 public:
  /// Throws InputError when the rate is not within 0.1..200 Hz.
  TriggerGenerator(TriggerLine& line, double rate_hz);
  ~TriggerGenerator();
  TriggerGenerator(const TriggerGenerator&) = delete;
  TriggerGenerator& operator=(const TriggerGenerator&) = delete;

 private:
  std::mutex mutex_;
  std::condition_variable stopped_;
  bool stop_ = false;
  std::thread thread_;
};

}  // namespace holdfast::sim
