// SPDX-License-Identifier: Apache-2.0
// A DDS domain of one's own for a test process, on loopback only, so that tests run in parallel.
#pragma once

#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <ctime>
#include <string>

#include <unistd.h>

namespace holdfast::bridge::dds {

/// Domain and discovery tag of this process and of the peers it starts. Above domain 100 the ports
/// would lie among the ephemeral ones.
inline std::uint32_t test_domain() {
  static const std::uint32_t domain = [] {
    const std::string pid = std::to_string(getpid());
    const std::string uri = std::string("file://" HOLDFAST_LOOPBACK_CONFIG) +
                            ",<CycloneDDS><Domain><Discovery><Tag>test-" + pid +
                            "</Tag></Discovery></Domain></CycloneDDS>";
    setenv("CYCLONEDDS_URI", uri.c_str(), 1);
    return 10 + static_cast<std::uint32_t>(getpid()) % 90;
  }();
  return domain;
}

/// Calls `condition` until it holds. False after 20 s: far beyond anything but a failure.
template <class F>
bool eventually(F&& condition) {
  const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(20);
  while (!condition()) {
    if (std::chrono::steady_clock::now() > until) return false;
    const timespec pause{0, 500'000};
    nanosleep(&pause, nullptr);
  }
  return true;
}

}  // namespace holdfast::bridge::dds
