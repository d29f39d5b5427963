// SPDX-License-Identifier: Apache-2.0
// A thread that does one kind of job, one at a time, when it is told to, and never holds up the one
// that tells. What a job works on and what it makes stay with the owner: they are the thread's from
// order() until take() says that it is done, the owner's otherwise.
#pragma once

#include <condition_variable>
#include <cstdint>
#include <functional>
#include <mutex>
#include <thread>

namespace holdfast::perception {

class JobThread {
 public:
  /// Starts the thread, with ordinary scheduling and its creator's CPUs. `job` must not throw.
  explicit JobThread(std::function<void()> job);
  ~JobThread();  ///< waits for the job in work; what it works on must outlive this
  JobThread(const JobThread&) = delete;
  JobThread& operator=(const JobThread&) = delete;

  // The owner's thread. None takes memory.
  /// Nothing is in work, nor done and not taken.
  [[nodiscard]] bool is_idle() const;
  /// When idle.
  void order();
  /// Whether the one ordered is done: said once, idle from then on.
  [[nodiscard]] bool take();
  /// Until nothing is in work.
  void wait();

 private:
  enum class State : std::uint8_t { idle, ordered, done, ending };
  void run();

  std::function<void()> job_;
  mutable std::mutex mutex_;  // of state_
  std::condition_variable changed_;
  State state_ = State::idle;
  std::thread thread_;  // last: it uses all the others
};

}  // namespace holdfast::perception
