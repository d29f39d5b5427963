// SPDX-License-Identifier: Apache-2.0
#include "bridge/can/microscope_watch.hpp"

#include <string>

#include <linux/can/error.h>

#include "rt/core/error.hpp"

namespace holdfast::bridge::can {
namespace {

using std::chrono::nanoseconds;

/// Faults that leave it open which optics are set.
bool is_in_doubt(FaultSet faults) noexcept {
  faults.erase(Fault::error_passive);
  faults.erase(Fault::transmit_queue_full);
  faults.erase(Fault::command_refused);
  return !faults.empty();
}

}  // namespace

std::string_view name(Fault fault) noexcept {
  switch (fault) {
    case Fault::node_missing:
      return "node_missing";
    case Fault::node_not_operational:
      return "node_not_operational";
    case Fault::state_silent:
      return "state_silent";
    case Fault::bus_off:
      return "bus_off";
    case Fault::error_passive:
      return "error_passive";
    case Fault::transmit_queue_full:
      return "transmit_queue_full";
    case Fault::receive_overflow:
      return "receive_overflow";
    case Fault::interface_down:
      return "interface_down";
    case Fault::message_corrupt:
      return "message_corrupt";
    case Fault::counter_skipped:
      return "counter_skipped";
    case Fault::command_refused:
      return "command_refused";
    case Fault::command_unconfirmed:
      return "command_unconfirmed";
  }
  return "unknown";
}

bool needs_recovery(FaultSet faults) noexcept {
  for (const Fault lifted : {Fault::node_missing, Fault::node_not_operational, Fault::state_silent,
                             Fault::error_passive, Fault::interface_down})
    faults.erase(lifted);
  return !faults.empty();
}

MicroscopeWatch::MicroscopeWatch(const MicroscopeParameters& parameters, nanoseconds now)
    : parameters_(parameters), t_heartbeat_(now), t_state_(now) {
  if (parameters.node < 1 || parameters.node > 127)
    throw InputError("microscope: node " + std::to_string(parameters.node) +
                     " must be in [1, 127]");
  const nanoseconds shortest = std::chrono::milliseconds(1);
  if (parameters.heartbeat_period < shortest || parameters.state_period < shortest ||
      parameters.confirm_timeout < shortest)
    throw InputError("microscope: heartbeat, state and confirm times must be at least 1 ms");
}

void MicroscopeWatch::take(const Frame& frame, nanoseconds now) noexcept {
  if (frame.is_error) {
    take_error(frame);
  } else if (frame.id == kHeartbeatId + parameters_.node) {
    const auto heartbeat = decode_heartbeat(frame, parameters_.node);
    if (!heartbeat) return raise(Fault::message_corrupt);
    follow_counter(heartbeat->counter, heartbeat_counter_);
    t_heartbeat_ = now;
    is_operational_ = heartbeat->state == NodeState::operational;
  } else if (frame.id == kStateId) {
    const auto state = decode_state(frame);
    if (!state) return raise(Fault::message_corrupt);
    take_state(*state, now);
  }
}

void MicroscopeWatch::take_error(const Frame& frame) noexcept {
  if ((frame.id & CAN_ERR_BUSOFF) != 0) report_.faults.insert(Fault::bus_off);
  if ((frame.id & CAN_ERR_CRTL) == 0) return;
  const std::uint8_t controller = frame.data[1];
  if ((controller & (CAN_ERR_CRTL_RX_OVERFLOW | CAN_ERR_CRTL_TX_OVERFLOW)) != 0)
    report_.faults.insert(Fault::receive_overflow);
  if ((controller & (CAN_ERR_CRTL_RX_PASSIVE | CAN_ERR_CRTL_TX_PASSIVE)) != 0)
    report_.faults.insert(Fault::error_passive);
  if ((controller & CAN_ERR_CRTL_ACTIVE) != 0) report_.faults.erase(Fault::error_passive);
}

void MicroscopeWatch::take_state(const StateMessage& message, nanoseconds now) noexcept {
  follow_counter(message.counter, state_counter_);
  optics_ = message.optics;
  report_.is_moving = message.is_moving;
  has_state_ = true;
  t_state_ = now;
}

void MicroscopeWatch::follow_counter(std::uint8_t counter,
                                     std::optional<std::uint8_t>& previous) noexcept {
  if (previous && counter != ((*previous + 1) & 0x0f)) raise(Fault::counter_skipped);
  previous = counter;
}

void MicroscopeWatch::supervise(nanoseconds now, bool is_up, std::uint64_t dropped) noexcept {
  const auto set = [this](Fault fault, bool is_present) {
    is_present ? report_.faults.insert(fault) : report_.faults.erase(fault);
  };
  // Counted from the start of supervision, so a node that was never there is missed as well.
  const bool is_missing = now - t_heartbeat_ > parameters_.heartbeat_period * 3 / 2;
  if (is_missing) heartbeat_counter_.reset();
  set(Fault::node_missing, is_missing);
  set(Fault::node_not_operational, !is_missing && heartbeat_counter_ && !is_operational_);
  const bool is_silent = now - t_state_ > parameters_.state_period * 3 / 2;
  if (is_silent) state_counter_.reset();
  set(Fault::state_silent, is_silent);
  set(Fault::interface_down, !is_up);
  if (dropped_seen_ && dropped != *dropped_seen_) raise(Fault::receive_overflow);
  dropped_seen_ = dropped;
  report_.t_state = t_state_;
  report_.optics.reset();
  if (has_state_ && !is_in_doubt(report_.faults)) report_.optics = optics_;
}

void MicroscopeWatch::forget() noexcept {
  report_ = {};
  heartbeat_counter_.reset();
  state_counter_.reset();
  has_state_ = false;  // what was known before is history
}

}  // namespace holdfast::bridge::can
