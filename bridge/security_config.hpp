// SPDX-License-Identifier: Apache-2.0
// Who a program is on DDS, as its configuration file states it. Unsecured must be asked for: nobody
// forgets it by leaving a line out.
#pragma once

#include <chrono>
#include <filesystem>

#include "bridge/config_file.hpp"

namespace holdfast::bridge {

struct SecurityConfig {
  std::filesystem::path folder;  ///< of `holdfast keys`; empty: unsecured, as was asked for
  std::chrono::sys_seconds valid_until;

  /// Takes `keys` as who this program is. Throws InputError when that is not a whole, valid
  /// identity.
  void use(const std::filesystem::path& keys);
};

/// `security` (a folder) or `allow_unsecured = true` of `dds`. Throws InputError on neither, on
/// both, and as SecurityConfig::use().
[[nodiscard]] SecurityConfig read_security(const ConfigSection& dds);

}  // namespace holdfast::bridge
