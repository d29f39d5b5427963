// SPDX-License-Identifier: Apache-2.0
// Sends what it is given to everybody who is connected: an OpenIGTLink server that only speaks.
// What comes in is read and thrown away unseen, so nothing that a client sends can change anything.
// It never waits for a client: one that does not take what it is sent is dropped.
//
// The protocol knows neither encryption nor who is there: loopback, unless told otherwise.
//
// One thread.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>

namespace holdfast::bridge::openigtlink {

struct ServerParameters {
  std::string address = "127.0.0.1";  ///< IPv4
  std::uint16_t port = 18944;         ///< 0: the system chooses
  bool allow_network = false;         ///< an address beyond loopback
  std::size_t clients_max = 4;        ///< more are closed at once
  std::size_t backlog_max = 1 << 20;  ///< bytes waiting for one client; beyond it is dropped
};

/// Throws InputError as the constructor does; opens nothing.
void check_server(const ServerParameters& parameters);

class Server {
 public:
  /// Listens. Throws InputError on an address that is none or is beyond loopback without
  /// `allow_network`, UnavailableError when the port cannot be had.
  explicit Server(const ServerParameters& parameters);
  ~Server();
  Server(const Server&) = delete;
  Server& operator=(const Server&) = delete;

  [[nodiscard]] std::uint16_t port() const noexcept;
  [[nodiscard]] std::size_t clients() const noexcept;
  [[nodiscard]] std::uint64_t dropped() const noexcept;  ///< for being slow, since start

  /// What each new client is sent first, before anything else; the newest counts.
  void set_greeting(std::string message);
  /// One whole message to every client.
  void send(std::string_view message);
  /// Accepts, discards what came in, sends what waits; returns after `duration`, or a little later.
  void serve(std::chrono::nanoseconds duration);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace holdfast::bridge::openigtlink
