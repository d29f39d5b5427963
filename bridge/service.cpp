// SPDX-License-Identifier: Apache-2.0
#include "bridge/service.hpp"

#include <atomic>
#include <chrono>

#include <systemd/sd-daemon.h>

namespace holdfast::bridge {
namespace {

using Clock = std::chrono::steady_clock;
constexpr std::chrono::milliseconds kAlivePeriod{250};

std::atomic<Clock::rep> alive_from{Clock::time_point::min().time_since_epoch().count()};

}  // namespace

// A manager that cannot be told is no reason to end: it will miss the sign of life, and act.
void service_is_ready() noexcept {
  (void)sd_notify(0, "READY=1");
}
void service_is_alive() noexcept {
  const Clock::time_point now = Clock::now();
  Clock::rep from = alive_from.load();
  const Clock::rep next = (now + kAlivePeriod).time_since_epoch().count();
  if (now.time_since_epoch().count() >= from && alive_from.compare_exchange_strong(from, next))
    (void)sd_notify(0, "WATCHDOG=1");
}
void service_is_ending() noexcept {
  (void)sd_notify(0, "STOPPING=1");
}

}  // namespace holdfast::bridge
