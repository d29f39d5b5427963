// SPDX-License-Identifier: Apache-2.0
#include "bridge/can/microscope.hpp"

#include <cmath>
#include <utility>

namespace holdfast::bridge::can {
namespace {

using std::chrono::nanoseconds;

constexpr int kFramesPerPoll = 256;  // a flood must not keep the caller here

}  // namespace

Microscope::Microscope(std::unique_ptr<Transport> transport, const MicroscopeParameters& parameters,
                       nanoseconds now)
    : transport_(std::move(transport)), parameters_(parameters), watch_(parameters, now) {
  watch_.supervise(now, transport_->is_up(), transport_->dropped());
}

const MicroscopeReport& Microscope::poll(nanoseconds now) noexcept {
  Frame frame;
  for (int i = 0; i < kFramesPerPoll && transport_->receive(frame); ++i) {
    if (!frame.is_error && frame.id == kConfirmId)
      take_confirm(frame);
    else
      watch_.take(frame, now);
  }
  if (pending_ && now - t_command_ > parameters_.confirm_timeout) {
    pending_.reset();
    watch_.raise(Fault::command_unconfirmed);
  }
  watch_.supervise(now, transport_->is_up(), transport_->dropped());
  report_ = watch_.report();
  if (pending_) report_.is_moving = true;
  return report_;
}

void Microscope::take_confirm(const Frame& frame) noexcept {
  const auto message = decode_confirm(frame);
  if (!message) return watch_.raise(Fault::message_corrupt);
  // An answer to nobody's question: another host commands the node, and the state tells.
  if (!pending_ || message->sequence != sequence_ || message->quantity != *pending_) return;
  pending_.reset();
  if (message->result == ConfirmResult::reached)
    confirmed_ = message;
  else
    watch_.raise(Fault::command_refused);
}

bool Microscope::command(Quantity quantity, double value, nanoseconds now) noexcept {
  const CommandMessage message{static_cast<std::uint8_t>(sequence_ + 1), quantity, value};
  const Frame frame = encode(message, parameters_.is_fd);
  const auto sent = decode_command(frame);  // what the range leaves of it
  const bool is_in_range = sent && std::abs(sent->value - value) <= resolution(quantity);
  if (pending_ || !is_in_range) return false;
  const SendResult result = transport_->send(frame);
  if (result == SendResult::queue_full) watch_.raise(Fault::transmit_queue_full);
  if (result == SendResult::down) watch_.raise(Fault::interface_down);
  if (result != SendResult::sent) return false;
  sequence_ = message.sequence;
  pending_ = quantity;
  t_command_ = now;
  confirmed_.reset();
  return true;
}

bool Microscope::recover(nanoseconds now) noexcept {
  if (watch_.faults().contains(Fault::bus_off) && !transport_->restart()) return false;
  watch_.forget();
  pending_.reset();
  watch_.supervise(now, transport_->is_up(), transport_->dropped());
  return true;
}

}  // namespace holdfast::bridge::can
