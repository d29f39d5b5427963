// SPDX-License-Identifier: Apache-2.0
#include "rt/guard/watchdog.hpp"

#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <unistd.h>

#include "rt/core/error.hpp"

namespace holdfast::guard {

Watchdog::Watchdog(const std::string& device) {
  if (device.empty()) return;
  fd_ = open(device.c_str(), O_WRONLY | O_CLOEXEC);
  if (fd_ < 0)
    throw UnavailableError("watchdog: " + device + ": " + std::strerror(errno) +
                           "; load its driver, or set watchdog.device = \"\"");
}

Watchdog::~Watchdog() {
  if (fd_ < 0) return;
  if (!has_given_up_) (void)!write(fd_, "V", 1);  // the kernel's word for an orderly end
  close(fd_);
}

void Watchdog::stroke() noexcept {
  if (fd_ >= 0 && !has_given_up_) (void)!write(fd_, "\0", 1);
}

}  // namespace holdfast::guard
