// SPDX-License-Identifier: Apache-2.0
// A CAN bus between two ends on one host, for hosts whose kernel has no CAN: the same frames over a
// Unix socket, in one process (a pair) or between two (a path). No arbitration, no bit errors; a
// full queue and a vanished peer behave as on a bus.
#pragma once

#include <memory>
#include <string>
#include <utility>

#include "bridge/can/frame.hpp"

namespace holdfast::bridge::can {

class LocalCan : public Transport {
 public:
  /// Both ends in one process. Throws UnavailableError.
  [[nodiscard]] static std::pair<std::unique_ptr<LocalCan>, std::unique_ptr<LocalCan>> make_pair();
  /// The end that waits at `path` (the node's); takes one peer at a time. Throws UnavailableError.
  [[nodiscard]] static std::unique_ptr<LocalCan> listen(const std::string& path);
  /// The end that goes there (the daemon's). Nobody there is no error: the bus is silent until
  /// somebody is. Throws InputError for a path that is too long.
  [[nodiscard]] static std::unique_ptr<LocalCan> connect(const std::string& path);
  ~LocalCan() override;

  [[nodiscard]] SendResult send(const Frame& frame) noexcept override;
  [[nodiscard]] bool receive(Frame& frame) noexcept override;
  [[nodiscard]] std::uint64_t dropped() const noexcept override { return 0; }
  [[nodiscard]] bool is_up() noexcept override { return true; }
  [[nodiscard]] bool restart() noexcept override { return true; }
  [[nodiscard]] int handle() const noexcept override { return peer_ >= 0 ? peer_ : listener_; }

 private:
  enum class Role : std::uint8_t { pair, listener, caller };
  LocalCan(Role role, int socket, std::string path);
  void seek_peer() noexcept;
  void drop_peer() noexcept;

  Role role_;
  int listener_ = -1;
  int peer_ = -1;
  std::string path_;
};

}  // namespace holdfast::bridge::can
