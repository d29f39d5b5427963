// SPDX-License-Identifier: Apache-2.0
// A CAN frame and the bus it travels on. Transport is the interface behind which SocketCAN and the
// local transport for hosts without CAN are alike. Plain values; nothing here waits.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

namespace holdfast::bridge::can {

struct Frame {
  std::uint32_t id = 0;   ///< 11 bits; of an error frame: the classes of linux/can/error.h
  bool is_fd = false;     ///< CAN FD (with bit-rate switch) instead of classic
  bool is_error = false;  ///< an error report of the controller, never on the wire
  std::uint8_t size = 0;  ///< bytes of data: 0..8, FD up to 64
  std::array<std::uint8_t, 64> data{};

  [[nodiscard]] std::span<const std::uint8_t> payload() const noexcept {
    return std::span(data).first(size);
  }
};

enum class SendResult : std::uint8_t {
  sent,        ///< handed to the controller's queue
  queue_full,  ///< ENOBUFS or a full socket: not sent
  down         ///< the interface is down or gone: not sent
};

class Transport {
 public:
  Transport() = default;
  virtual ~Transport() = default;
  Transport(const Transport&) = delete;
  Transport& operator=(const Transport&) = delete;

  /// Does not wait.
  [[nodiscard]] virtual SendResult send(const Frame& frame) noexcept = 0;
  /// The oldest frame that has arrived; false when there is none. Does not wait.
  [[nodiscard]] virtual bool receive(Frame& frame) noexcept = 0;
  /// Frames lost on our side because they were not received in time; never decreases.
  [[nodiscard]] virtual std::uint64_t dropped() const noexcept = 0;
  /// False since the interface is down or gone.
  [[nodiscard]] virtual bool is_up() noexcept = 0;
  /// Restarts the controller after bus-off. False when it cannot; then the caller may try again.
  [[nodiscard]] virtual bool restart() noexcept = 0;
  /// Readable when a frame has arrived; for poll(2).
  [[nodiscard]] virtual int handle() const noexcept = 0;
};

}  // namespace holdfast::bridge::can
