// SPDX-License-Identifier: Apache-2.0
// Is this machine fit to run the loop? Measures what the system gives and says what to do about
// each shortcoming. Changes nothing, prints nothing.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace holdfast::rt {

/// ok: as it should be. warning: works, with less margin or not in every setup. failed: holdfastd
/// refuses to start, or a function it needs is not there.
enum class DoctorState : std::uint8_t { ok, warning, failed };

struct DoctorFinding {
  std::string check;  ///< short and stable, e.g. "kernel"
  DoctorState state{};
  std::string measured;  ///< what was found, with its unit
  std::string advice;    ///< what to do; empty when ok
};

struct DoctorParameters {
  int fifo_priority = 80;                              ///< tried on a thread of our own
  std::size_t lock_bytes = 64 * 1024 * 1024;           ///< tried with mlock
  std::size_t socket_buffer_bytes = 16 * 1024 * 1024;  ///< what a GigE camera wants
  std::optional<int> cameras_found;                    ///< absent: not looked for
  std::filesystem::path root = "/";                    ///< where proc and sys are read
};

/// One finding for each check, always the same checks in the same order (cameras only if given).
/// Takes up to half a second (a multicast datagram is awaited). Not for the real-time path.
[[nodiscard]] std::vector<DoctorFinding> run_doctor(const DoctorParameters& parameters);

}  // namespace holdfast::rt
