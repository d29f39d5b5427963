// SPDX-License-Identifier: Apache-2.0
// Who else writes a topic on this domain, from DDS discovery. One thread.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

#include "bridge/dds/participant.hpp"

namespace holdfast::bridge::dds {

class PublicationWatch {
 public:
  /// Watches the writers of `topic` that do not belong to `participant`. Throws UnavailableError.
  PublicationWatch(const Participant& participant, std::string topic);

  /// True while such a writer is known. Does not wait; takes what discovery has reported since the
  /// previous call (allocates when there is something: not for the control loop's thread). A writer
  /// whose process was killed counts until its discovery lease ends (Cyclone: 10 s).
  [[nodiscard]] bool has_other_writer() noexcept;

  /// The same, but waits up to `patience` for one to show up.
  [[nodiscard]] bool wait_for_other_writer(std::chrono::nanoseconds patience);

 private:
  void update(const void* sample, std::uint64_t instance, bool is_alive);

  std::string topic_;
  std::uint64_t own_participant_ = 0;
  Entity reader_;
  Entity waitset_;
  std::vector<std::uint64_t> others_;
  bool is_sound_ = true;
};

}  // namespace holdfast::bridge::dds
