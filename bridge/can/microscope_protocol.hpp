// SPDX-License-Identifier: Apache-2.0
// The microscope's messages on CAN and their bytes, as docs/can.md and config/microscope.dbc give
// them. Pure: no bus, no clock. Decoding accepts any frame and refuses all that is not exactly so.
#pragma once

#include <cstdint>
#include <optional>

#include "bridge/can/frame.hpp"

namespace holdfast::bridge::can {

inline constexpr std::uint32_t kCommandId = 0x200;
inline constexpr std::uint32_t kConfirmId = 0x280;
inline constexpr std::uint32_t kStateId = 0x180;
inline constexpr std::uint32_t kHeartbeatId = 0x700;  // + node

enum class Quantity : std::uint8_t { zoom = 1, focus = 2, illumination = 3 };

/// Ranges: zoom 0..6.5535; focus 0..16777.215 mm (working distance); illumination 0..100 %.
struct Optics {
  double zoom = 0;
  double focus_mm = 0;
  double illumination_percent = 0;
};

struct CommandMessage {
  std::uint8_t sequence = 0;
  Quantity quantity = Quantity::zoom;
  double value = 0;  ///< in the quantity's unit
};

enum class ConfirmResult : std::uint8_t { reached = 0, out_of_range = 1, device_fault = 2 };
struct ConfirmMessage {
  std::uint8_t sequence = 0;
  Quantity quantity = Quantity::zoom;
  ConfirmResult result = ConfirmResult::device_fault;
  double value = 0;  ///< as measured by the device's encoder
};

struct StateMessage {
  Optics optics;
  bool is_moving = false;
  std::uint8_t counter = 0;  ///< 0..15, +1 a message
};

enum class NodeState : std::uint8_t { booting = 0, stopped = 4, operational = 5 };
struct HeartbeatMessage {
  NodeState state = NodeState::booting;
  std::uint8_t counter = 0;  ///< 0..15, +1 a message
};

/// Values are clamped to their range. `is_fd`: as a CAN FD frame; the bytes are the same.
[[nodiscard]] Frame encode(const CommandMessage& message, bool is_fd) noexcept;
[[nodiscard]] Frame encode(const ConfirmMessage& message, bool is_fd) noexcept;
[[nodiscard]] Frame encode(const StateMessage& message, bool is_fd) noexcept;
[[nodiscard]] Frame encode(const HeartbeatMessage& message, std::uint8_t node, bool is_fd) noexcept;

/// Empty unless id, length, CRC and every field are valid.
[[nodiscard]] std::optional<CommandMessage> decode_command(const Frame& frame) noexcept;
[[nodiscard]] std::optional<ConfirmMessage> decode_confirm(const Frame& frame) noexcept;
[[nodiscard]] std::optional<StateMessage> decode_state(const Frame& frame) noexcept;
[[nodiscard]] std::optional<HeartbeatMessage> decode_heartbeat(const Frame& frame,
                                                               std::uint8_t node) noexcept;

/// What is left of a value after its way over the bus: how exactly a command can be confirmed.
[[nodiscard]] double resolution(Quantity quantity) noexcept;

}  // namespace holdfast::bridge::can
