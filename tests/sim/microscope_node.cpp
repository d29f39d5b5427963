// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/microscope_node.hpp"

#include <algorithm>
#include <cmath>

namespace holdfast::sim {

using namespace bridge::can;  // NOLINT(google-build-using-namespace): this file is its node

void MicroscopeNode::poll(std::chrono::nanoseconds now) {
  Frame frame;
  while (transport_->receive(frame)) {
    const auto command = decode_command(frame);
    if (command && !is_silent) take(*command, now);
  }
  drive(now);
  if (is_silent) return;
  if (t_heartbeat_.count() == 0 || now - t_heartbeat_ >= parameters_.heartbeat_period) {
    t_heartbeat_ = now;
    const HeartbeatMessage heartbeat{state, heartbeat_counter_};
    heartbeat_counter_ = (heartbeat_counter_ + 1) & 0x0f;
    send(encode(heartbeat, parameters_.node, parameters_.is_fd));
  }
  if (t_state_.count() == 0 || now - t_state_ >= parameters_.state_period) {
    t_state_ = now;
    const StateMessage message{optics_, goal_.has_value(), state_counter_};
    state_counter_ = (state_counter_ + 1) & 0x0f;
    send(encode(message, parameters_.is_fd));
  }
}

void MicroscopeNode::turn(Quantity quantity, double value) {
  value_of(quantity) = value;
}

void MicroscopeNode::take(const CommandMessage& command, std::chrono::nanoseconds /*now*/) {
  goal_ = command;
  const bool is_zoom = command.quantity == Quantity::zoom;
  const bool is_focus = command.quantity == Quantity::focus;
  const double min = is_zoom ? parameters_.zoom_min : is_focus ? parameters_.focus_min_mm : 0;
  const double max = is_zoom ? parameters_.zoom_max : is_focus ? parameters_.focus_max_mm : 100;
  const double slack = 1e-9;
  if (command.value < min - slack || command.value > max + slack)
    confirm(ConfirmResult::out_of_range);
  else if (is_faulty)
    confirm(ConfirmResult::device_fault);
}

void MicroscopeNode::drive(std::chrono::nanoseconds now) {
  const auto previous = t_previous_.value_or(now);
  t_previous_ = now;
  if (!goal_) return;
  double& value = value_of(goal_->quantity);
  const double seconds = std::chrono::duration<double>(now - previous).count();
  double reach = 1e9;  // light is switched at once
  if (goal_->quantity == Quantity::zoom) reach = parameters_.zoom_per_s * seconds;
  if (goal_->quantity == Quantity::focus) reach = parameters_.focus_mm_per_s * seconds;
  value += std::clamp(goal_->value - value, -reach, reach);
  if (std::abs(value - goal_->value) < 0.5 * resolution(goal_->quantity))
    confirm(ConfirmResult::reached);
}

void MicroscopeNode::confirm(ConfirmResult result) {
  const ConfirmMessage message{goal_->sequence, goal_->quantity, result, value_of(goal_->quantity)};
  goal_.reset();
  send(encode(message, parameters_.is_fd));
}

double& MicroscopeNode::value_of(Quantity quantity) {
  if (quantity == Quantity::zoom) return optics_.zoom;
  return quantity == Quantity::focus ? optics_.focus_mm : optics_.illumination_percent;
}

}  // namespace holdfast::sim
