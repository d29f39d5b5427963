// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/trigger_line.hpp"

#include <cmath>

#include <fmt/core.h>

#include "rt/core/clock.hpp"
#include "rt/core/error.hpp"

namespace holdfast::sim {

using std::chrono::nanoseconds;

TriggerLine::Pulse TriggerLine::fire() {
  const std::lock_guard lock(mutex_);
  newest_ = {newest_.number + 1, rt::monotonic_now()};
  recent_[newest_.number % recent_.size()] = newest_;
  fired_.notify_all();
  return newest_;
}

std::optional<TriggerLine::Pulse> TriggerLine::wait_after(std::uint64_t seen,
                                                          std::chrono::microseconds timeout) {
  std::unique_lock lock(mutex_);
  if (!fired_.wait_for(lock, timeout, [&] { return newest_.number > seen; })) return std::nullopt;
  return newest_;
}

std::uint64_t TriggerLine::number_at(nanoseconds t) const {
  const std::lock_guard lock(mutex_);
  std::uint64_t found = 0;
  for (const Pulse& pulse : recent_)
    if (pulse.t <= t && pulse.number > found) found = pulse.number;
  return found;
}

TriggerGenerator::TriggerGenerator(TriggerLine& line, double rate_hz) {
  if (!(rate_hz >= 0.1 && rate_hz <= 200))
    throw InputError(fmt::format("trigger rate {:g} Hz is outside 0.1..200", rate_hz));
  const nanoseconds period(std::llround(1e9 / rate_hz));
  thread_ = std::thread([this, &line, period] {
    auto next = std::chrono::steady_clock::now();
    std::unique_lock lock(mutex_);
    while (!stopped_.wait_until(lock, next, [this] { return stop_; })) {
      line.fire();
      next += period;
    }
  });
}

TriggerGenerator::~TriggerGenerator() {
  {
    const std::lock_guard lock(mutex_);
    stop_ = true;
  }
  stopped_.notify_all();
  thread_.join();
}

}  // namespace holdfast::sim
