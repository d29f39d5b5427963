// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/private_network.hpp"

#include <cerrno>
#include <cstring>
#include <filesystem>

#include <fcntl.h>
#include <fmt/core.h>
#include <net/if.h>
#include <netinet/in.h>
#include <sched.h>
#include <sys/file.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include "rt/core/error.hpp"

namespace holdfast::sim {
namespace {

bool is_loopback_raised() {
  const int descriptor = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  if (descriptor < 0) return false;
  ifreq request{};
  std::strncpy(request.ifr_name, "lo", IFNAMSIZ - 1);
  bool is_raised = ioctl(descriptor, SIOCGIFFLAGS, &request) == 0;
  request.ifr_flags = static_cast<short>(request.ifr_flags | IFF_UP | IFF_RUNNING);
  is_raised = is_raised && ioctl(descriptor, SIOCSIFFLAGS, &request) == 0;
  close(descriptor);
  return is_raised;
}

// 127.0.0.2 answers anyway, but Aravis serves only addresses that an interface lists.
bool is_second_address_added() {
  const int descriptor = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  if (descriptor < 0) return false;
  ifreq request{};
  std::strncpy(request.ifr_name, "lo:1", IFNAMSIZ - 1);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK + 1);
  std::memcpy(&request.ifr_addr, &address, sizeof address);
  const bool is_added = ioctl(descriptor, SIOCSIFADDR, &request) == 0;
  close(descriptor);
  return is_added;
}

// Held until the process ends.
void take_turn_on_host_network() {
  const auto path = std::filesystem::temp_directory_path() / "holdfast-host-network.lock";
  const int descriptor = open(path.c_str(), O_CREAT | O_RDWR | O_CLOEXEC, 0666);
  if (descriptor < 0 || flock(descriptor, LOCK_EX) != 0)
    throw UnavailableError(fmt::format("{}: {}", path.string(), std::strerror(errno)));
}

}  // namespace

void enter_private_network() {
  const int flags = geteuid() == 0 ? CLONE_NEWNET : CLONE_NEWUSER | CLONE_NEWNET;
  if (unshare(flags) != 0) {
    take_turn_on_host_network();
    return;
  }
  if (!is_loopback_raised() || !is_second_address_added())
    throw UnavailableError(fmt::format("private network: lo: {}", std::strerror(errno)));
}

}  // namespace holdfast::sim
