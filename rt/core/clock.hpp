// SPDX-License-Identifier: Apache-2.0
// The two clocks of the house as std::chrono::nanoseconds since their epochs. Monotonic time is
// what everything is decided on; UTC only travels beside it in messages and logs.
#pragma once

#include <chrono>
#include <ctime>

namespace holdfast::rt {

namespace detail {
[[nodiscard]] inline std::chrono::nanoseconds read_clock(clockid_t clock) noexcept {
  timespec time{};
  clock_gettime(clock, &time);  // cannot fail: both clock ids are always present on Linux
  return std::chrono::seconds(time.tv_sec) + std::chrono::nanoseconds(time.tv_nsec);
}
}  // namespace detail

/// CLOCK_MONOTONIC. Any thread; no system call (vDSO), no allocation.
[[nodiscard]] inline std::chrono::nanoseconds monotonic_now() noexcept {
  return detail::read_clock(CLOCK_MONOTONIC);
}

/// CLOCK_REALTIME. Any thread; no system call (vDSO), no allocation. May step.
[[nodiscard]] inline std::chrono::nanoseconds utc_now() noexcept {
  return detail::read_clock(CLOCK_REALTIME);
}

}  // namespace holdfast::rt
