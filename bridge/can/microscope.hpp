// SPDX-License-Identifier: Apache-2.0
// The microscope on CAN: what its frames say (microscope_watch.hpp), and commands until they are
// confirmed. Reports; decides nothing. One thread; time is passed in; nothing waits or allocates
// after construction.
#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>

#include "bridge/can/frame.hpp"
#include "bridge/can/microscope_protocol.hpp"
#include "bridge/can/microscope_watch.hpp"

namespace holdfast::bridge::can {

class Microscope {
 public:
  /// Supervision begins at `now`. Throws InputError for a parameter out of range.
  Microscope(std::unique_ptr<Transport> transport, const MicroscopeParameters& parameters,
             std::chrono::nanoseconds now);

  /// Takes in what has arrived and judges what has not. Call it at least every millisecond.
  const MicroscopeReport& poll(std::chrono::nanoseconds now) noexcept;

  /// Sends a command; false when one is under way, the value is out of range, or it could not be
  /// sent (a fault says why). Confirmed by `confirmed()`.
  [[nodiscard]] bool command(Quantity quantity, double value,
                             std::chrono::nanoseconds now) noexcept;
  /// The newest confirmed command; absent until one was, and while one is under way.
  [[nodiscard]] const std::optional<ConfirmMessage>& confirmed() const noexcept {
    return confirmed_;
  }

  /// The only way out of the faults that stay (all but those that the next good message or the end
  /// of its cause lifts: node_missing, node_not_operational, state_silent, error_passive,
  /// interface_down): forgets them and restarts the controller if it is bus-off. False when that
  /// failed.
  [[nodiscard]] bool recover(std::chrono::nanoseconds now) noexcept;

  [[nodiscard]] int handle() const noexcept { return transport_->handle(); }

 private:
  void take_confirm(const Frame& frame) noexcept;

  std::unique_ptr<Transport> transport_;
  MicroscopeParameters parameters_;
  MicroscopeWatch watch_;
  MicroscopeReport report_;
  std::uint8_t sequence_ = 0;
  std::optional<Quantity> pending_;
  std::chrono::nanoseconds t_command_{};
  std::optional<ConfirmMessage> confirmed_;
};

}  // namespace holdfast::bridge::can
