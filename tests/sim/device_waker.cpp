// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/device_waker.hpp"

#include <array>
#include <cstring>
#include <ctime>

#include <sys/socket.h>
#include <unistd.h>

#include "rt/core/error.hpp"

namespace holdfast::sim {
namespace {

constexpr std::uint16_t kGvcpPort = 3956;
constexpr std::int64_t kAfterGridUs = 300;
// GVCP DISCOVERY_CMD: key, flags, command 0x0002, length 0, request id 1. The answer is not read.
constexpr std::array<std::uint8_t, 8> kDiscovery{0x42, 0x01, 0x00, 0x02, 0x00, 0x00, 0x00, 0x01};

}  // namespace

DeviceWaker::DeviceWaker(in_addr device)
    : socket_(socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0)) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr = device;
  address.sin_port = htons(kGvcpPort);
  sockaddr generic{};
  std::memcpy(&generic, &address, sizeof generic);
  if (socket_ < 0 || connect(socket_, &generic, sizeof address) != 0) {
    if (socket_ >= 0) close(socket_);
    throw UnavailableError("virtual camera: no socket to wake the device with");
  }
  thread_ = std::thread([this] { run(); });
}

DeviceWaker::~DeviceWaker() {
  stop_ = true;
  thread_.join();
  close(socket_);
}

void DeviceWaker::run() {
  while (!stop_) {
    timespec now{};
    clock_gettime(CLOCK_REALTIME, &now);
    const std::int64_t now_us = now.tv_sec * 1'000'000 + now.tv_nsec / 1000;
    const std::int64_t period_us = period_us_;
    const std::int64_t next_us = (now_us / period_us + 1) * period_us + kAfterGridUs;
    const timespec next{next_us / 1'000'000, next_us % 1'000'000 * 1000};
    clock_nanosleep(CLOCK_REALTIME, TIMER_ABSTIME, &next, nullptr);
    (void)send(socket_, kDiscovery.data(), kDiscovery.size(), 0);
    std::array<std::uint8_t, 1024> answer;
    while (recv(socket_, answer.data(), answer.size(), 0) > 0) {
    }
  }
}

}  // namespace holdfast::sim
