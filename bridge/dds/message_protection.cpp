// SPDX-License-Identifier: Apache-2.0
#include "bridge/dds/message_protection.hpp"

#include <algorithm>
#include <cerrno>
#include <ctime>
#include <limits>

#include <sys/random.h>

#include "rt/core/error.hpp"

namespace holdfast::bridge::dds {
namespace {

std::chrono::nanoseconds read_clock(clockid_t clock) noexcept {
  timespec t{};
  clock_gettime(clock, &t);
  return std::chrono::seconds(t.tv_sec) + std::chrono::nanoseconds(t.tv_nsec);
}

std::uint32_t whole_microseconds(std::chrono::nanoseconds validity) noexcept {
  const auto us = std::chrono::duration_cast<std::chrono::microseconds>(validity).count();
  using Limits = std::numeric_limits<std::uint32_t>;
  return static_cast<std::uint32_t>(std::clamp<std::int64_t>(us, 0, Limits::max()));
}

}  // namespace

Clocks read_clocks() noexcept {
  return {.monotonic = read_clock(CLOCK_MONOTONIC), .utc = read_clock(CLOCK_REALTIME)};
}

std::uint32_t random_source() {
  std::uint32_t source = 0;
  while (source == 0) {
    const ssize_t n = getrandom(&source, sizeof source, 0);
    if (n == static_cast<ssize_t>(sizeof source)) continue;
    if (n < 0 && errno == EINTR) continue;
    throw UnavailableError("getrandom: no random source identity");
  }
  return source;
}

msg::Protection make_protection(safety::DataId data_id, std::uint32_t source, std::uint32_t counter,
                                std::chrono::nanoseconds validity, Clocks now) noexcept {
  return {.version = safety::kProtectionVersion,
          .data_id = static_cast<std::uint8_t>(data_id),
          .source = source,
          .counter = counter,
          .t_monotonic_ns = now.monotonic.count(),
          .t_utc_ns = now.utc.count(),
          .validity_us = whole_microseconds(validity),
          .crc32c = 0};
}

safety::Protection received(const msg::Protection& p) noexcept {
  return {.version = p.version,
          .data_id = static_cast<safety::DataId>(p.data_id),
          .source = p.source,
          .counter = p.counter,
          .t_monotonic_ns = p.t_monotonic_ns,
          .t_utc_ns = p.t_utc_ns,
          .validity_us = p.validity_us,
          .crc32c = p.crc32c};
}

}  // namespace holdfast::bridge::dds
