// SPDX-License-Identifier: Apache-2.0
// Who listens on the wire and sends again what was heard: every UDP datagram on the loopback of
// this process's network, without a key and without taking part. Linux, AF_PACKET; needs the rights
// that a network of one's own gives (tests/sim/private_network.hpp).
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace holdfast::bridge::test {

struct Datagram {
  std::uint16_t source_port = 0, destination_port = 0;
  std::vector<std::uint8_t> payload;
};

class PacketCapture {
 public:
  /// Starts to listen. Throws UnavailableError with the system's reason.
  PacketCapture();
  ~PacketCapture();
  PacketCapture(const PacketCapture&) = delete;
  PacketCapture& operator=(const PacketCapture&) = delete;

  /// What has come since the last call: to 127.0.0.1, each once, in order. Does not wait. Throws
  /// UnavailableError when the system lost some: then nothing can be said of what was not seen.
  [[nodiscard]] std::vector<Datagram> take();

  /// Sends it again exactly as heard: same addresses, same ports, same bytes.
  void send_again(const Datagram& datagram);

 private:
  int listening_ = -1, sending_ = -1;
};

[[nodiscard]] bool contains(std::span<const std::uint8_t> bytes,
                            std::span<const std::uint8_t> part);

}  // namespace holdfast::bridge::test
