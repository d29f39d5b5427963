// SPDX-License-Identifier: Apache-2.0
// EventQueue: everything from one writer thread to one reader thread, in order, wait-free (ring).
// For what must not be overwritten: camera events, operator commands. When it is full the new event
// is refused and counted; the reader must treat a grown count as a fault, for an event is gone.
#pragma once

#include <array>
#include <atomic>
#include <bit>
#include <cstddef>
#include <cstdint>

#include "rt/core/mailbox.hpp"

namespace holdfast::rt {

/// Holds up to N events; N is a power of two.
template <OwnsNothing T, std::size_t N>
class EventQueue {
  static_assert(std::has_single_bit(N), "N must be a power of two");

 public:
  EventQueue() = default;
  EventQueue(const EventQueue&) = delete;
  EventQueue& operator=(const EventQueue&) = delete;

  /// Writer thread only. False when full: the event is not stored, and overflow_count() grows.
  [[nodiscard]] bool try_push(const T& event) noexcept {
    const std::uint64_t tail = tail_.load(std::memory_order_relaxed);  // only we write it
    // Acquire: pairs with the reader's release of head_, so that its copy out of the slot we are
    // about to reuse has ended.
    if (tail - head_.load(std::memory_order_acquire) == N) {
      // A plain load and store: the writer is alone. Relaxed: the count carries no other data.
      overflows_.store(overflows_.load(std::memory_order_relaxed) + 1, std::memory_order_relaxed);
      return false;
    }
    slots_[tail % N] = event;
    // Release: the event is complete before the reader can see the new tail.
    tail_.store(tail + 1, std::memory_order_release);
    return true;
  }

  /// Reader thread only. False when empty; then `event` is left alone.
  [[nodiscard]] bool try_pop(T& event) noexcept {
    const std::uint64_t head = head_.load(std::memory_order_relaxed);  // only we write it
    // Acquire: pairs with the writer's release of tail_, so that the whole event is seen.
    if (tail_.load(std::memory_order_acquire) == head) return false;
    event = slots_[head % N];
    // Release: our copy out of the slot ends before the writer can see it as free.
    head_.store(head + 1, std::memory_order_release);
    return true;
  }

  /// Events refused since construction; never decreases. Any thread.
  [[nodiscard]] std::uint64_t overflow_count() const noexcept {
    return overflows_.load(std::memory_order_relaxed);
  }

 private:
  static constexpr std::size_t kCacheLine = 64;
  std::array<T, N> slots_{};
  // 64-bit counts of all pushes and pops: at 1 MHz they wrap after half a million years.
  alignas(kCacheLine) std::atomic<std::uint64_t> head_{0};  // pops, written by the reader
  alignas(kCacheLine) std::atomic<std::uint64_t> tail_{0};  // pushes, written by the writer
  std::atomic<std::uint64_t> overflows_{0};
  static_assert(std::atomic<std::uint64_t>::is_always_lock_free);
};

}  // namespace holdfast::rt
