// SPDX-License-Identifier: Apache-2.0
// What the frames of the microscope's node say, and their absence: zoom, focus and illumination as
// its encoders report them, and everything that is wrong with node or bus by name. A plain value:
// no bus, no clock, no decisions; frames and time are passed in. One thread; nothing allocates.
#pragma once

#include <chrono>
#include <cstdint>
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
  bool is_moving = false;        ///< a drive runs; of Microscope: or a command is not confirmed
  std::chrono::nanoseconds t_state{};  ///< reception of the newest state
  FaultSet faults;
};

/// True when a fault is among them that only a recovery ends; the others end with the next good
/// message or with their cause (docs/can.md).
[[nodiscard]] bool needs_recovery(FaultSet faults) noexcept;

class MicroscopeWatch {
 public:
  /// Supervision begins at `now`. Throws InputError for a parameter out of range.
  MicroscopeWatch(const MicroscopeParameters& parameters, std::chrono::nanoseconds now);

  /// One frame, in the order of arrival; frames of others are passed over.
  void take(const Frame& frame, std::chrono::nanoseconds now) noexcept;
  /// Judges what has not arrived, after all that has was taken. `dropped` as Transport counts.
  void supervise(std::chrono::nanoseconds now, bool is_up, std::uint64_t dropped) noexcept;
  /// A fault that the caller saw, and that only a recovery ends.
  void raise(Fault fault) noexcept { report_.faults.insert(fault); }
  /// Forgets faults and all that was known.
  void forget() noexcept;

  /// As of the newest supervise().
  [[nodiscard]] const MicroscopeReport& report() const noexcept { return report_; }
  [[nodiscard]] FaultSet faults() const noexcept { return report_.faults; }

 private:
  void take_error(const Frame& frame) noexcept;
  void take_state(const StateMessage& message, std::chrono::nanoseconds now) noexcept;
  void follow_counter(std::uint8_t counter, std::optional<std::uint8_t>& previous) noexcept;

  MicroscopeParameters parameters_;
  MicroscopeReport report_;
  Optics optics_;
  bool has_state_ = false;
  bool is_operational_ = false;
  std::chrono::nanoseconds t_heartbeat_;
  std::chrono::nanoseconds t_state_;
  std::optional<std::uint8_t> heartbeat_counter_, state_counter_;
  std::optional<std::uint64_t> dropped_seen_;
};

}  // namespace holdfast::bridge::can
