// SPDX-License-Identifier: Apache-2.0
// CyclicThread: calls a function once per slot of an absolute time grid on CLOCK_MONOTONIC, from a
// SCHED_FIFO thread bound to a CPU. What it cannot have from the system it refuses at start.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace holdfast::rt {

/// One cycle. Slot n of the grid is at epoch + phase + n * period.
struct CycleInfo {
  std::uint64_t index = 0;                 ///< cycles called before this one
  std::chrono::nanoseconds t_scheduled{};  ///< the first slot not served yet
  std::chrono::nanoseconds t_woken{};      ///< when this cycle began
  /// t_woken - t_scheduled, never negative. It counts from the first slot that was not served, so a
  /// gap of many slots shows as one large lateness.
  std::chrono::nanoseconds lateness{};
  std::uint64_t missed = 0;  ///< slots that passed unserved, all told, before this cycle
};

struct CyclicThreadParameters {
  std::string name = "cyclic";  ///< as in ps and gdb; cut to 15 characters
  std::chrono::nanoseconds period = std::chrono::milliseconds(1);
  std::chrono::nanoseconds phase{};  ///< 0 <= phase < period
  /// On CLOCK_MONOTONIC. Threads with the same epoch and period share one grid, and their phases
  /// order them in it without a wake-up call. Default: the clock's own epoch, so they share anyway.
  std::chrono::nanoseconds epoch{};
  std::optional<int> fifo_priority = 80;  ///< 1..99; absent: ordinary scheduling, by choice
  std::optional<int> cpu;                 ///< absent: wherever the scheduler likes
  bool allow_non_rt = false;  ///< denied priority or affinity becomes a warning instead of an error
  std::size_t stack_bytes = 4 * 1024 * 1024;      ///< includes the libraries' thread-local storage
  std::size_t stack_prefault_bytes = 256 * 1024;  ///< touched before the first cycle
};

class CyclicThread {
 public:
  /// Called on the cyclic thread. An exception that leaves it ends the process.
  using Callback = std::function<void(const CycleInfo&)>;

  /// Starts the thread; its first cycle is the grid's next slot. Throws InputError for a parameter
  /// out of range, UnavailableError when the system denies the thread, its priority or its CPU
  /// (unless allow_non_rt), naming facility, value, the system's reason and the cure; then no cycle
  /// has run.
  CyclicThread(const CyclicThreadParameters& parameters, Callback callback);
  /// stop().
  ~CyclicThread();
  CyclicThread(const CyclicThread&) = delete;
  CyclicThread& operator=(const CyclicThread&) = delete;

  /// At most the cycle that is just beginning still runs; returns at once. Any thread, also from
  /// the callback.
  void request_stop() noexcept;
  /// request_stop(), then waits for the thread's end: up to one period and the running cycle. Not
  /// from the callback.
  void stop() noexcept;

  /// What was denied, one line each; empty when the thread is real-time as asked. Fixed at start.
  [[nodiscard]] const std::vector<std::string>& warnings() const noexcept { return warnings_; }

 private:
  struct Shared;
  std::unique_ptr<Shared> shared_;
  std::vector<std::string> warnings_;
};

}  // namespace holdfast::rt
