// SPDX-License-Identifier: Apache-2.0
// The microscope on CAN: zoom, focus and illumination as its encoders report them, commands until
// they are confirmed, and everything that is wrong with node or bus by name. Reports; decides
// nothing. One thread; time is passed in; nothing waits or allocates after construction.
#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string_view>

#include "bridge/can/frame.hpp"
#include "bridge/can/microscope_protocol.hpp"

namespace holdfast::bridge::can {

enum class Fault : std::uint8_t {
  node_missing,          ///< no heartbeat for 1.5 periods, also when there never was one
  node_not_operational,  ///< the node beats, but says that it is booting or stopped
  state_silent,          ///< no state for 1.5 of its periods
  bus_off,               ///< the controller has left the bus; recover() brings it back
  error_passive,         ///< the controller has counted many errors
  transmit_queue_full,   ///< ENOBUFS: a command was not sent
  receive_overflow,      ///< frames were lost on our side
  interface_down,        ///< the network interface is down or gone
  message_corrupt,       ///< a frame of the node failed its check
  counter_skipped,       ///< messages of the node were lost or repeated
  command_refused,       ///< the node could not or would not
  command_unconfirmed    ///< the node did not answer in time
};
inline constexpr unsigned kFaultCount = 12;
[[nodiscard]] std::string_view name(Fault fault) noexcept;  ///< as spelled above

class FaultSet {
 public:
  constexpr void insert(Fault fault) noexcept { bits_ |= bit(fault); }
  constexpr void erase(Fault fault) noexcept { bits_ &= ~bit(fault); }
  [[nodiscard]] constexpr bool contains(Fault fault) const noexcept {
    return (bits_ & bit(fault)) != 0;
  }
  [[nodiscard]] constexpr bool empty() const noexcept { return bits_ == 0; }
  [[nodiscard]] constexpr std::uint32_t bits() const noexcept { return bits_; }

 private:
  static constexpr std::uint32_t bit(Fault fault) noexcept {
    return 1U << static_cast<unsigned>(fault);
  }
  std::uint32_t bits_ = 0;
};

struct MicroscopeParameters {
  std::uint8_t node = 1;  ///< 1..127
  bool is_fd = false;     ///< send CAN FD frames; either kind is understood
  std::chrono::nanoseconds heartbeat_period = std::chrono::milliseconds(20);
  std::chrono::nanoseconds state_period = std::chrono::milliseconds(20);
  /// From a command to its confirmation: longer than the slowest drive takes.
  std::chrono::nanoseconds confirm_timeout = std::chrono::seconds(10);
};

/// What is known now.
struct MicroscopeReport {
  std::optional<Optics> optics;  ///< absent while a fault leaves it in doubt: nothing is invented
  bool is_moving = false;        ///< a drive runs, or a command is not confirmed yet
  std::chrono::nanoseconds t_state{};  ///< reception of the newest state
  FaultSet faults;
};

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
  void take(const Frame& frame, std::chrono::nanoseconds now) noexcept;
  void take_error(const Frame& frame) noexcept;
  void take_state(const StateMessage& message, std::chrono::nanoseconds now) noexcept;
  void take_confirm(const ConfirmMessage& message) noexcept;
  void supervise(std::chrono::nanoseconds now) noexcept;
  void follow_counter(std::uint8_t counter, std::optional<std::uint8_t>& previous) noexcept;

  std::unique_ptr<Transport> transport_;
  MicroscopeParameters parameters_;
  MicroscopeReport report_;
  Optics optics_;
  bool has_state_ = false;
  bool is_drive_moving_ = false;
  bool is_operational_ = false;
  std::chrono::nanoseconds t_heartbeat_;
  std::chrono::nanoseconds t_state_;
  std::optional<std::uint8_t> heartbeat_counter_, state_counter_;
  std::uint64_t dropped_seen_ = 0;
  std::uint8_t sequence_ = 0;
  std::optional<Quantity> pending_;
  std::chrono::nanoseconds t_command_{};
  std::optional<ConfirmMessage> confirmed_;
};

}  // namespace holdfast::bridge::can
