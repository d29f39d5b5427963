// SPDX-License-Identifier: Apache-2.0
// The service manager that started this process (systemd's sd_notify protocol). Without one
// (NOTIFY_SOCKET is not set) each call does nothing. Any thread but a real-time one: each call may
// be a system call.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace holdfast::bridge {

/// What was promised at start is there: units that are ordered after this one may start.
void service_is_ready() noexcept;
/// This process does its work; passed on at most four times a second, however often it is called.
/// systemd kills and restarts one that does not say so for WatchdogSec.
void service_is_alive() noexcept;
/// This process ends as it was told to.
void service_is_ending() noexcept;

/// Whether all of N counters of work done have moved since it was last so.
template <std::size_t N>
class Progress {
 public:
  /// True at the first call, and whenever each counter differs from its value when true was last
  /// returned: one thread that stands still is enough for false.
  [[nodiscard]] bool all_moved(const std::array<std::uint64_t, N>& counters) noexcept {
    for (std::size_t i = 0; i < N; ++i)
      if (!is_first_ && counters[i] == last_[i]) return false;
    is_first_ = false;
    last_ = counters;
    return true;
  }

 private:
  bool is_first_ = true;
  std::array<std::uint64_t, N> last_{};
};

}  // namespace holdfast::bridge
