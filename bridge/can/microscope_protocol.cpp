// SPDX-License-Identifier: Apache-2.0
#include "bridge/can/microscope_protocol.hpp"

#include <algorithm>
#include <cmath>
#include <initializer_list>

namespace holdfast::bridge::can {
namespace {

constexpr double kZoomUnit = 1e-4;
constexpr double kFocusUnitMm = 1e-3;
constexpr double kIlluminationUnit = 0.5;
constexpr std::uint32_t kIlluminationMax = 200;
constexpr std::uint8_t kLength = 8;
constexpr std::uint8_t kCounterMask = 0x0f;
constexpr std::uint8_t kMoving = 0x10;

/// CRC-8 SAE J1850 (polynomial 0x1D, init and final XOR 0xFF) over the identifier, low byte first,
/// and the first seven bytes: a frame under another identifier is another message.
std::uint8_t crc8(std::uint32_t id, const Frame& frame) noexcept {
  std::uint8_t crc = 0xff;
  const auto add = [&crc](std::uint8_t byte) {
    crc = static_cast<std::uint8_t>(crc ^ byte);
    for (int bit = 0; bit < 8; ++bit) {
      const std::uint32_t shifted = static_cast<std::uint32_t>(crc) << 1U;
      crc = static_cast<std::uint8_t>(shifted ^ ((crc & 0x80U) != 0 ? 0x1dU : 0U));
    }
  };
  add(static_cast<std::uint8_t>(id & 0xffU));
  add(static_cast<std::uint8_t>(id >> 8U));
  for (std::size_t i = 0; i + 1 < kLength; ++i) add(frame.data[i]);
  return static_cast<std::uint8_t>(crc ^ 0xffU);
}

std::uint32_t scaled(double value, double unit, std::uint32_t max) noexcept {
  if (!(value > 0)) return 0;
  return static_cast<std::uint32_t>(std::min(std::round(value / unit), static_cast<double>(max)));
}

struct Range {
  double unit;
  std::uint32_t max;
};
Range range(Quantity quantity) noexcept {
  switch (quantity) {
    case Quantity::zoom:
      return {kZoomUnit, 0xffff};
    case Quantity::focus:
      return {kFocusUnitMm, 0xffffff};
    case Quantity::illumination:
      return {kIlluminationUnit, kIlluminationMax};
  }
  return {1, 0};
}

Frame frame_of(std::uint32_t id, std::initializer_list<std::uint32_t> bytes, bool is_fd) noexcept {
  Frame frame;
  frame.id = id;
  frame.is_fd = is_fd;
  frame.size = kLength;
  std::size_t i = 0;
  for (const std::uint32_t byte : bytes) frame.data[i++] = static_cast<std::uint8_t>(byte & 0xffU);
  frame.data[kLength - 1] = crc8(id, frame);
  return frame;
}

bool is_intact(const Frame& frame, std::uint32_t id) noexcept {
  return !frame.is_error && frame.id == id && frame.size == kLength &&
         frame.data[kLength - 1] == crc8(id, frame);
}

std::uint32_t little_endian(const Frame& frame, std::size_t first, std::size_t count) noexcept {
  std::uint32_t value = 0;
  for (std::size_t i = count; i-- > 0;) value = value << 8U | frame.data[first + i];
  return value;
}

std::optional<Quantity> quantity_of(std::uint8_t code) noexcept {
  if (code < 1 || code > 3) return std::nullopt;
  return static_cast<Quantity>(code);
}

}  // namespace

Frame encode(const CommandMessage& m, bool is_fd) noexcept {
  const Range r = range(m.quantity);
  const std::uint32_t value = scaled(m.value, r.unit, r.max);
  return frame_of(
      kCommandId,
      {m.sequence, static_cast<std::uint32_t>(m.quantity), value, value >> 8U, value >> 16U, 0, 0},
      is_fd);
}

Frame encode(const ConfirmMessage& m, bool is_fd) noexcept {
  const Range r = range(m.quantity);
  const std::uint32_t value = scaled(m.value, r.unit, r.max);
  return frame_of(kConfirmId,
                  {m.sequence, static_cast<std::uint32_t>(m.quantity), value, value >> 8U,
                   value >> 16U, static_cast<std::uint32_t>(m.result), 0},
                  is_fd);
}

Frame encode(const StateMessage& m, bool is_fd) noexcept {
  const std::uint32_t zoom = scaled(m.optics.zoom, kZoomUnit, 0xffff);
  const std::uint32_t focus = scaled(m.optics.focus_mm, kFocusUnitMm, 0xffffff);
  const std::uint32_t light =
      scaled(m.optics.illumination_percent, kIlluminationUnit, kIlluminationMax);
  const std::uint32_t flags = (m.counter & kCounterMask) | (m.is_moving ? kMoving : 0U);
  return frame_of(kStateId, {zoom, zoom >> 8U, focus, focus >> 8U, focus >> 16U, light, flags},
                  is_fd);
}

Frame encode(const HeartbeatMessage& m, std::uint8_t node, bool is_fd) noexcept {
  return frame_of(kHeartbeatId + node,
                  {static_cast<std::uint32_t>(m.state),
                   static_cast<std::uint32_t>(m.counter) & kCounterMask, 0, 0, 0, 0, 0},
                  is_fd);
}

std::optional<CommandMessage> decode_command(const Frame& frame) noexcept {
  if (!is_intact(frame, kCommandId)) return std::nullopt;
  const auto quantity = quantity_of(frame.data[1]);
  const std::uint32_t value = little_endian(frame, 2, 3);
  if (!quantity || value > range(*quantity).max || frame.data[5] != 0 || frame.data[6] != 0)
    return std::nullopt;
  return CommandMessage{frame.data[0], *quantity, value * range(*quantity).unit};
}

std::optional<ConfirmMessage> decode_confirm(const Frame& frame) noexcept {
  if (!is_intact(frame, kConfirmId)) return std::nullopt;
  const auto quantity = quantity_of(frame.data[1]);
  const std::uint32_t value = little_endian(frame, 2, 3);
  if (!quantity || value > range(*quantity).max || frame.data[5] > 2 || frame.data[6] != 0)
    return std::nullopt;
  return ConfirmMessage{frame.data[0], *quantity, static_cast<ConfirmResult>(frame.data[5]),
                        value * range(*quantity).unit};
}

std::optional<StateMessage> decode_state(const Frame& frame) noexcept {
  if (!is_intact(frame, kStateId)) return std::nullopt;
  const std::uint8_t light = frame.data[5];
  const std::uint8_t flags = frame.data[6];
  if (light > kIlluminationMax || (flags & ~(kCounterMask | kMoving)) != 0) return std::nullopt;
  return StateMessage{{little_endian(frame, 0, 2) * kZoomUnit,
                       little_endian(frame, 2, 3) * kFocusUnitMm, light * kIlluminationUnit},
                      (flags & kMoving) != 0,
                      static_cast<std::uint8_t>(flags & kCounterMask)};
}

std::optional<HeartbeatMessage> decode_heartbeat(const Frame& frame, std::uint8_t node) noexcept {
  if (!is_intact(frame, kHeartbeatId + node)) return std::nullopt;
  const std::uint8_t state = frame.data[0];
  const bool is_known = state == 0 || state == 4 || state == 5;
  const auto rest = std::span(frame.data).subspan(2, 5);
  if (!is_known || frame.data[1] > kCounterMask ||
      std::ranges::any_of(rest, [](std::uint8_t byte) { return byte != 0; }))
    return std::nullopt;
  return HeartbeatMessage{static_cast<NodeState>(state), frame.data[1]};
}

double resolution(Quantity quantity) noexcept {
  return range(quantity).unit;
}

}  // namespace holdfast::bridge::can
