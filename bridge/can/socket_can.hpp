// SPDX-License-Identifier: Apache-2.0
// SocketCAN: classic and FD frames, the controller's error reports, and the kernel's count of what
// it had to drop.
#pragma once

#include <string>

#include "bridge/can/frame.hpp"

namespace holdfast::bridge::can {

class SocketCan : public Transport {
 public:
  /// Binds to a network interface ("can0", "vcan0"). Throws UnavailableError naming the interface,
  /// the system's reason and the cure.
  explicit SocketCan(const std::string& interface);
  ~SocketCan() override;

  [[nodiscard]] SendResult send(const Frame& frame) noexcept override;
  [[nodiscard]] bool receive(Frame& frame) noexcept override;
  [[nodiscard]] std::uint64_t dropped() const noexcept override { return dropped_; }
  [[nodiscard]] bool is_up() noexcept override;
  /// As `ip link set IFACE type can restart`; needs CAP_NET_ADMIN. Does not wait for the bus.
  [[nodiscard]] bool restart() noexcept override;
  [[nodiscard]] int handle() const noexcept override { return socket_; }

 private:
  int socket_ = -1;
  unsigned index_ = 0;
  std::uint64_t dropped_ = 0;
};

}  // namespace holdfast::bridge::can
