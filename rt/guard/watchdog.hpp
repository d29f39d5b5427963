// SPDX-License-Identifier: Apache-2.0
// The machine's hardware watchdog (/dev/watchdog): resets it when it is no longer stroked.
#pragma once

#include <string>

namespace holdfast::guard {

class Watchdog {
 public:
  /// Starts the watchdog; an empty device is none. Throws UnavailableError naming device and
  /// reason.
  explicit Watchdog(const std::string& device);
  /// Disarms it when the program ends in order; a killed program does not get here.
  ~Watchdog();
  Watchdog(const Watchdog&) = delete;
  Watchdog& operator=(const Watchdog&) = delete;

  void stroke() noexcept;
  /// From now on it may not be disarmed either.
  void give_up() noexcept { has_given_up_ = true; }

 private:
  int fd_ = -1;
  bool has_given_up_ = false;
};

}  // namespace holdfast::guard
