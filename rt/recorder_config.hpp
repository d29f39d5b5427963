// SPDX-License-Identifier: Apache-2.0
// Where the daemon's recordings go.
#pragma once

#include <cstdint>
#include <filesystem>

namespace holdfast::rt {

struct RecorderConfig {
  std::filesystem::path folder;
  std::uint64_t size_max_bytes = 8'000'000'000;  ///< of all files in it; the oldest go first
};

}  // namespace holdfast::rt
