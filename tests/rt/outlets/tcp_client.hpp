// SPDX-License-Identifier: Apache-2.0
// A client on loopback that never waits: the test's own thread turns the server.
#pragma once

#include <cerrno>
#include <stdexcept>
#include <string>

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

namespace holdfast::bridge::openigtlink::testing {

class TcpClient {
 public:
  explicit TcpClient(std::uint16_t port) : socket_(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(port);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (connect(socket_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
      throw std::runtime_error("connect");
  }
  ~TcpClient() { close(socket_); }
  TcpClient(const TcpClient&) = delete;
  TcpClient& operator=(const TcpClient&) = delete;

  void send(const std::string& bytes) const {
    (void)::send(socket_, bytes.data(), bytes.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
  }
  /// All that has arrived since the beginning.
  const std::string& receive() {
    char buffer[65536];
    ssize_t n = 0;
    while ((n = recv(socket_, buffer, sizeof buffer, MSG_DONTWAIT)) > 0)
      all_.append(buffer, static_cast<std::size_t>(n));
    is_closed_ = n == 0 || (n < 0 && errno == ECONNRESET);
    return all_;
  }
  [[nodiscard]] bool is_closed() {
    (void)receive();
    return is_closed_;
  }

 private:
  int socket_;
  std::string all_;
  bool is_closed_ = false;
};

}  // namespace holdfast::bridge::openigtlink::testing
