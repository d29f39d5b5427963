// SPDX-License-Identifier: Apache-2.0
// systemd's side of sd_notify: the socket that NOTIFY_SOCKET names, for this process and what it
// starts.
#pragma once

#include <array>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <stdexcept>
#include <string>

#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

namespace holdfast::testing {

class ServiceManager {
 public:
  explicit ServiceManager(const std::filesystem::path& folder) : path_(folder / "notify") {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    const std::string name = path_.string();
    if (name.size() >= sizeof address.sun_path) throw std::runtime_error("path too long: " + name);
    std::memcpy(address.sun_path, name.c_str(), name.size() + 1);
    std::filesystem::remove(path_);
    fd_ = socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    if (fd_ < 0 || bind(fd_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
      throw std::runtime_error("cannot listen on " + name);
    setenv("NOTIFY_SOCKET", name.c_str(), 1);
  }
  ~ServiceManager() {
    unsetenv("NOTIFY_SOCKET");
    close(fd_);
    std::filesystem::remove(path_);
  }
  ServiceManager(const ServiceManager&) = delete;
  ServiceManager& operator=(const ServiceManager&) = delete;

  /// The next message; empty when none comes within `patience`.
  std::string next(std::chrono::milliseconds patience) const {
    pollfd readable{fd_, POLLIN, 0};
    if (poll(&readable, 1, static_cast<int>(patience.count())) <= 0) return {};
    std::array<char, 256> text{};
    const ssize_t n = recv(fd_, text.data(), text.size(), 0);
    return n > 0 ? std::string(text.data(), static_cast<std::size_t>(n)) : std::string{};
  }
  /// Forgets what has come.
  void forget() const {
    while (!next(std::chrono::milliseconds(0)).empty()) {
    }
  }

 private:
  std::filesystem::path path_;
  int fd_ = -1;
};

}  // namespace holdfast::testing
