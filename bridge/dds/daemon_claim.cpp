// SPDX-License-Identifier: Apache-2.0
#include "bridge/dds/daemon_claim.hpp"

#include <cerrno>
#include <cstddef>
#include <cstring>
#include <string>

#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "bridge/dds/topics.hpp"
#include "rt/core/error.hpp"

namespace holdfast::bridge::dds {
namespace {

struct Address {
  sockaddr_un un{};
  socklen_t size = 0;
  [[nodiscard]] const sockaddr* get() const noexcept {
    return reinterpret_cast<const sockaddr*>(&un);  // the sockets interface asks for it
  }
};

// The leading zero byte makes the name abstract: no file, nothing left behind by a killed process.
Address lock_address(std::uint32_t domain) {
  const std::string name = "holdfast-daemon-domain-" + std::to_string(domain);
  Address address;
  address.un.sun_family = AF_UNIX;
  std::memcpy(address.un.sun_path + 1, name.data(), name.size());
  address.size = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + 1 + name.size());
  return address;
}

// The process that listens on the address, for the message only; empty when it cannot be told.
std::string holder(const Address& address) {
  const int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  if (fd < 0) return {};
  ucred peer{};
  socklen_t size = sizeof peer;
  const bool is_known = connect(fd, address.get(), address.size) == 0 &&
                        getsockopt(fd, SOL_SOCKET, SO_PEERCRED, &peer, &size) == 0;
  close(fd);
  return is_known ? " (pid " + std::to_string(peer.pid) + ")" : std::string();
}

std::string already_there(std::uint32_t domain) {
  return "domain " + std::to_string(domain) + " already has a Holdfast daemon";
}

}  // namespace

DomainLock::DomainLock(std::uint32_t domain)
    : socket_(socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
  const Address address = lock_address(domain);
  if (socket_ >= 0 && bind(socket_, address.get(), address.size) == 0 && listen(socket_, 1) == 0)
    return;
  const int error = errno;
  if (socket_ >= 0) close(socket_);
  if (error == EADDRINUSE) throw InputError(already_there(domain) + holder(address));
  throw UnavailableError("cannot lock domain " + std::to_string(domain) + ": " +
                         std::strerror(error));
}

DomainLock::~DomainLock() {
  close(socket_);
}

DaemonClaim::DaemonClaim(const Participant& participant, std::chrono::nanoseconds look)
    : lock_(participant.domain()), watch_(participant, Topic<msg::CompensatedPose>::policy().name) {
  if (watch_.wait_for_other_writer(look))
    throw InputError(already_there(participant.domain()) +
                     ": another participant writes holdfast/compensated_pose");
}

}  // namespace holdfast::bridge::dds
