// SPDX-License-Identifier: Apache-2.0
// Keeps Aravis' fake camera on its grid. Its thread polls its sockets with a time-out that it
// computes by an unsigned subtraction: when the next frame's instant passes between its check and
// that subtraction, it sleeps for 100 ms instead of not at all (0.8.26; about one frame in 200). A
// datagram ends that sleep, so one is sent shortly after each instant of the grid.
#pragma once

#include <atomic>
#include <chrono>
#include <thread>

#include <netinet/in.h>

namespace holdfast::sim {

class DeviceWaker {
 public:
  /// Sends to the GVCP port of `device`. Throws UnavailableError.
  explicit DeviceWaker(in_addr device);
  ~DeviceWaker();
  DeviceWaker(const DeviceWaker&) = delete;
  DeviceWaker& operator=(const DeviceWaker&) = delete;

  /// The grid: multiples of the period on CLOCK_REALTIME. Any thread.
  void set_period(std::chrono::microseconds period) noexcept { period_us_ = period.count(); }

 private:
  void run();

  int socket_ = -1;
  std::atomic<std::int64_t> period_us_{33'333};
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

}  // namespace holdfast::sim
