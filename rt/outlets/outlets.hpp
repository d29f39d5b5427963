// SPDX-License-Identifier: Apache-2.0
// holdfast-outlets' configuration and its loop: hears a Holdfast domain as an observer and tells
// ROS 2 and OpenIGTLink. Writes nothing to the Holdfast domain; nothing comes in from the others.
#pragma once

#include <filesystem>

#include "rt/observer/observer.hpp"
#include "rt/outlets/igtl_outlet.hpp"
#include "rt/outlets/ros2_outlet.hpp"

namespace holdfast::outlets {

struct OutletsConfig {
  observer::ObserverConfig observer;
  Ros2Settings ros2;
  IgtlSettings openigtlink;
  std::filesystem::path live_view;  ///< the file that holdfastd writes; empty: no picture is told
};

/// Annotated example: config/outlets.toml. Throws InputError naming file, line, column, key, value.
[[nodiscard]] OutletsConfig load_outlets_config(const std::filesystem::path& file);

/// Throws InputError when no outlet is on, when the ROS 2 domain is the daemon's, and on an address
/// that cannot be used.
void check_outlets(const OutletsConfig& config);

/// Until SIGINT or SIGTERM. Throws as check_outlets(), UnavailableError when DDS or the port is not
/// there.
void run_outlets(const OutletsConfig& config);

}  // namespace holdfast::outlets
