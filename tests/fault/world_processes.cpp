// SPDX-License-Identifier: Apache-2.0
// Processes that are stopped and go on (SIGSTOP, SIGCONT; a debugger; a host that is short of
// processors): nobody tells them, and what came for them meanwhile is all there when they wake.
#include <algorithm>
#include <functional>
#include <utility>

#include "tests/fault/world.hpp"

namespace holdfast::fault {
namespace {

bool is_paused(nanoseconds pause, nanoseconds since) {
  return pause > nanoseconds(0) && since / pause % 2 == 0;
}

}  // namespace

void World::run_scheduler() {
  const nanoseconds daemon_pause = disturbance.daemon_pause, guard_pause = disturbance.guard_pause;
  if (daemon_pause + guard_pause == nanoseconds(0)) return;
  if (t_pause_began_ == nanoseconds(0)) t_pause_began_ = now_;
  const nanoseconds since = now_ - t_pause_began_;
  const bool was_daemon_suspended = is_daemon_suspended_;
  is_daemon_suspended_ = is_paused(daemon_pause, since);
  if (is_daemon_suspended_ && !was_daemon_suspended) suspend_daemon();
  if (was_daemon_suspended && !is_daemon_suspended_) resume_daemon();
  is_guard_suspended_ = is_paused(guard_pause, since);
  if (is_guard_suspended_) return;
  for (const GuardMessage& message : std::exchange(guard_inbox_, {})) tell_guard(message);
}

/// Caught between protecting a message and giving it to the wire: it goes out when all is over.
void World::suspend_daemon() {
  const auto is_caught = [this](const Envelope&) { return happens(0.5); };
  const auto rest = std::stable_partition(wire_.begin(), wire_.end(), std::not_fn(is_caught));
  half_sent_.assign(rest, wire_.end());
  wire_.erase(rest, wire_.end());
}

void World::resume_daemon() {
  for (Envelope& envelope : half_sent_) {
    envelope.t_arrival = now_ + microseconds(100);
    wire_.push_back(envelope);
  }
  half_sent_.clear();
  for (const bridge::can::Frame& frame : std::exchange(bus_queue_, {})) hear(frame);
  for (const msg::RobotStatus& status : std::exchange(daemon_inbox_, {})) take_robot_status(status);
}

/// A frame on the bus. It waits in the socket while our reader does not run.
void World::hear(const bridge::can::Frame& frame) {
  if (is_daemon_suspended_)
    bus_queue_.push_back(frame);
  else
    watch_.take(frame, now_);
}

void World::tell_guard(const GuardMessage& message) {
  if (disturbance.is_guard_dead) return;
  if (is_guard_suspended_)
    guard_inbox_.push_back(message);
  else
    std::visit([this](const auto& m) { guard_.take(m, clocks()); }, message);
}

}  // namespace holdfast::fault
