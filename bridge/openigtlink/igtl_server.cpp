// SPDX-License-Identifier: Apache-2.0
#include "bridge/openigtlink/igtl_server.hpp"

#include <array>
#include <cerrno>
#include <ctime>
#include <system_error>
#include <utility>
#include <vector>

#include <arpa/inet.h>
#include <fmt/format.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include "rt/core/error.hpp"

namespace holdfast::bridge::openigtlink {
namespace {

using std::chrono::nanoseconds;

class Socket {
 public:
  explicit Socket(int handle) noexcept : handle_(handle) {}
  ~Socket() {
    if (handle_ >= 0) close(handle_);
  }
  Socket(Socket&& other) noexcept : handle_(std::exchange(other.handle_, -1)) {}
  Socket& operator=(Socket&& other) noexcept {
    std::swap(handle_, other.handle_);
    return *this;
  }
  Socket(const Socket&) = delete;
  Socket& operator=(const Socket&) = delete;
  [[nodiscard]] int handle() const noexcept { return handle_; }

 private:
  int handle_;
};

struct Client {
  Socket socket;
  std::string unsent;
  bool is_over = false;
};

sockaddr_in address_of(const ServerParameters& parameters) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(parameters.port);
  if (inet_pton(AF_INET, parameters.address.c_str(), &address.sin_addr) != 1)
    throw InputError(fmt::format("openigtlink: '{}' is no IPv4 address", parameters.address));
  constexpr std::uint32_t kLoopback = 127;
  if (!parameters.allow_network && ntohl(address.sin_addr.s_addr) >> 24U != kLoopback)
    throw InputError(
        fmt::format("openigtlink: {} is beyond loopback, and OpenIGTLink knows neither encryption "
                    "nor who reads: allow_network = true if that is meant",
                    parameters.address));
  return address;
}

[[noreturn]] void fail(const ServerParameters& parameters, int error) {
  throw UnavailableError(fmt::format("openigtlink: cannot listen on {}:{}: {}", parameters.address,
                                     parameters.port, std::generic_category().message(error)));
}

Socket listening(const ServerParameters& parameters) {
  const sockaddr_in address = address_of(parameters);
  Socket socket(::socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
  const int on = 1;
  if (socket.handle() < 0 ||
      setsockopt(socket.handle(), SOL_SOCKET, SO_REUSEADDR, &on, sizeof on) != 0 ||
      // NOLINTNEXTLINE(cppcoreguidelines-pro-type-reinterpret-cast): the socket API's convention
      bind(socket.handle(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0 ||
      listen(socket.handle(), 8) != 0)
    fail(parameters, errno);
  return socket;
}

bool is_transient(int error) noexcept {
  return error == EAGAIN || error == EINTR;
}

/// Sends what the socket takes now.
void flush(Client& client) {
  while (!client.unsent.empty()) {
    const ssize_t n = ::send(client.socket.handle(), client.unsent.data(), client.unsent.size(),
                             MSG_NOSIGNAL | MSG_DONTWAIT);
    if (n < 0) {
      client.is_over = !is_transient(errno);
      return;
    }
    client.unsent.erase(0, static_cast<std::size_t>(n));
  }
}

/// At most this much a turn, so that a client that talks without end does not keep us.
void discard_input(Client& client) {
  std::array<char, 4096> buffer;  // NOLINT(cppcoreguidelines-pro-type-member-init): never read
  for (int turn = 0; turn < 16; ++turn) {
    const ssize_t n = recv(client.socket.handle(), buffer.data(), buffer.size(), MSG_DONTWAIT);
    if (n > 0) continue;
    client.is_over = n == 0 || !is_transient(errno);
    return;
  }
}

}  // namespace

struct Server::Impl {
  explicit Impl(const ServerParameters& p) : parameters(p), listener(listening(p)) {}

  void accept_all() {
    for (;;) {
      Socket socket(accept4(listener.handle(), nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC));
      if (socket.handle() < 0) return;  // none left, or one that is gone already
      if (clients.size() >= parameters.clients_max) continue;
      const int on = 1;
      (void)setsockopt(socket.handle(), IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
      clients.push_back({std::move(socket), greeting});
      flush(clients.back());
    }
  }
  void remove_ended() {
    std::erase_if(clients, [](const Client& client) { return client.is_over; });
  }
  /// Until something happens or `patience` is over.
  void turn(nanoseconds patience) {
    std::vector<pollfd> all{{listener.handle(), POLLIN, 0}};
    for (const Client& client : clients) {
      const int events = client.unsent.empty() ? POLLIN : POLLIN | POLLOUT;
      all.push_back({client.socket.handle(), static_cast<short>(events), 0});
    }
    const auto seconds = std::chrono::floor<std::chrono::seconds>(patience);
    const timespec timeout{seconds.count(), (patience - seconds).count()};
    if (ppoll(all.data(), all.size(), &timeout, nullptr) <= 0) return;
    for (std::size_t i = 0; i < clients.size(); ++i) {
      const int happened = all[i + 1].revents;
      if ((happened & (POLLIN | POLLHUP | POLLERR)) != 0) discard_input(clients[i]);
      if ((happened & POLLOUT) != 0 && !clients[i].is_over) flush(clients[i]);
    }
    if (all[0].revents != 0) accept_all();
    remove_ended();
  }

  ServerParameters parameters;
  Socket listener;
  std::vector<Client> clients;
  std::string greeting;
  std::uint64_t dropped = 0;
};

void check_server(const ServerParameters& parameters) {
  (void)address_of(parameters);
}

Server::Server(const ServerParameters& parameters) : impl_(std::make_unique<Impl>(parameters)) {}
Server::~Server() = default;

std::uint16_t Server::port() const noexcept {
  sockaddr_in address{};
  socklen_t size = sizeof address;
  // NOLINTNEXTLINE(cppcoreguidelines-pro-type-reinterpret-cast): the socket API's convention
  getsockname(impl_->listener.handle(), reinterpret_cast<sockaddr*>(&address), &size);
  return ntohs(address.sin_port);
}

std::size_t Server::clients() const noexcept {
  return impl_->clients.size();
}
std::uint64_t Server::dropped() const noexcept {
  return impl_->dropped;
}

void Server::set_greeting(std::string message) {
  impl_->greeting = std::move(message);
}

void Server::send(std::string_view message) {
  for (Client& client : impl_->clients) {
    if (client.unsent.size() + message.size() > impl_->parameters.backlog_max) {
      client.is_over = true;
      ++impl_->dropped;
      continue;
    }
    client.unsent += message;
    flush(client);
  }
  impl_->remove_ended();
}

void Server::serve(nanoseconds duration) {
  const auto end = std::chrono::steady_clock::now() + duration;
  for (auto left = duration; left > nanoseconds::zero();
       left = end - std::chrono::steady_clock::now())
    impl_->turn(left);
}

}  // namespace holdfast::bridge::openigtlink
