// SPDX-License-Identifier: Apache-2.0
// StopLatch: carries "permission was withdrawn" from one thread to another such that no stop is
// lost, however late the other looks. It stands beside a Mailbox, in which a stop and the next pose
// would overwrite each other.
//
// Order of use, which makes it exact:
//   deciding thread, each cycle:    1. raise() if motion is not permitted   2. mailbox.publish()
//   publishing thread, each cycle:  1. mailbox.try_take()                   2. latch.take()
// Publishing then synchronises with taking, so whoever has taken the value of cycle n has every
// raise up to cycle n in the latch. A value of a cycle <= Stop::sequence must not be sent as a
// permission, and the stop is sent before any newer one.
#pragma once

#include <atomic>
#include <cstdint>
#include <optional>

namespace holdfast::rt {

/// All raises since the previous take.
struct Stop {
  std::uint64_t reasons = 0;   ///< of all of them, or-ed
  std::uint64_t sequence = 0;  ///< cycle of the newest of them, or of a still newer raise
};

class StopLatch {
 public:
  StopLatch() = default;
  StopLatch(const StopLatch&) = delete;
  StopLatch& operator=(const StopLatch&) = delete;

  /// Deciding thread only; wait-free. `reasons`: bit 0 is the latch's own and ignored (it makes a
  /// raise without reasons a raise too). `sequence` must not decrease.
  void raise(std::uint64_t reasons, std::uint64_t sequence) noexcept {
    // Relaxed: ordered before the fetch_or by its release. So a taker that sees these reasons sees
    // this sequence or, if we are already in the next raise, a newer one; that only widens the
    // stop.
    sequence_.store(sequence, std::memory_order_relaxed);
    // A read-modify-write: a raise between another raise and its take adds, never replaces.
    reasons_.fetch_or(reasons | kRaised, std::memory_order_release);
  }

  /// Publishing thread only; wait-free. Empties the latch; nothing if no stop was raised since.
  [[nodiscard]] std::optional<Stop> take() noexcept {
    // One exchange, not a load and a store: a raise in between would be erased unseen.
    const std::uint64_t reasons = reasons_.exchange(0, std::memory_order_acquire);
    if (reasons == 0) return std::nullopt;
    return Stop{reasons & ~kRaised, sequence_.load(std::memory_order_relaxed)};
  }

 private:
  static constexpr std::uint64_t kRaised = 1;
  std::atomic<std::uint64_t> reasons_{0};
  std::atomic<std::uint64_t> sequence_{0};
  static_assert(std::atomic<std::uint64_t>::is_always_lock_free);
};

}  // namespace holdfast::rt
