// SPDX-License-Identifier: Apache-2.0
// Mailbox: the latest value from one writer thread to one reader thread, wait-free on both sides
// (triple buffer). A value not taken before the next publish is overwritten: for states, never for
// events (event_queue.hpp) and never alone for stops (stop_latch.hpp).
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <type_traits>

namespace holdfast::rt {

/// What may cross a real-time boundary by copy: a value that owns nothing. Such a copy neither
/// allocates, locks nor throws; std::string, std::vector and cv::Mat are rejected here.
/// (std::is_nothrow_copy_assignable would say it better, but fixed-size Eigen types lack noexcept.)
template <typename T>
concept OwnsNothing = std::is_default_constructible_v<T> && std::is_copy_assignable_v<T> &&
    std::is_trivially_destructible_v<T>;

template <OwnsNothing T>
class Mailbox {
 public:
  Mailbox() = default;
  Mailbox(const Mailbox&) = delete;
  Mailbox& operator=(const Mailbox&) = delete;

  /// Writer thread only. Replaces whatever was not taken yet. One copy and one atomic exchange.
  void publish(const T& value) noexcept {
    slots_[write_] = value;
    // Release: the slot's content is complete before the reader can get its index. Acquire: the
    // slot handed back was last read by the reader; without it our next write could be reordered
    // before the end of that read, and the reader would see a torn value.
    write_ =
        shared_.exchange(static_cast<std::uint8_t>(write_ | kFresh), std::memory_order_acq_rel) &
        kIndex;
  }

  /// Reader thread only. True and the newest value if one was published since the last take that
  /// returned true; else false, and `value` is left alone.
  [[nodiscard]] bool try_take(T& value) noexcept {
    // Relaxed is enough to look: only this thread clears the flag, so a set flag stays set until
    // the exchange, which orders the content. A flag seen too late costs one try.
    if ((shared_.load(std::memory_order_relaxed) & kFresh) == 0) return false;
    // Acquire: pairs with the writer's release, so the whole value is seen. Release: our reads of
    // the slot handed back end before the writer can start to overwrite it.
    read_ = shared_.exchange(read_, std::memory_order_acq_rel) & kIndex;
    value = slots_[read_];
    return true;
  }

 private:
  static constexpr std::uint8_t kIndex = 3;
  static constexpr std::uint8_t kFresh = 4;
  static constexpr std::size_t kCacheLine = 64;

  // Each index is in exactly one of write_, read_ and shared_, so nobody ever waits for a slot.
  std::array<T, 3> slots_{};
  alignas(kCacheLine) std::atomic<std::uint8_t> shared_{1};
  alignas(kCacheLine) std::uint8_t write_ = 0;  // the writer's
  alignas(kCacheLine) std::uint8_t read_ = 2;   // the reader's
  static_assert(std::atomic<std::uint8_t>::is_always_lock_free);
};

}  // namespace holdfast::rt
