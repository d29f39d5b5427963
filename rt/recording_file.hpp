// SPDX-License-Identifier: Apache-2.0
// The bytes of one recording file: its topics and the messages on them. Formats only.
#pragma once

#include <optional>
#include <string>

#include "bridge/recorder/mcap_writer.hpp"
#include "rt/recording.hpp"

namespace holdfast::rt {

class RecordingFile {
 public:
  /// Starts with the session and, where known, the registration in force.
  RecordingFile(const RecordedSession& session,
                const std::optional<RecordedRegistration>& registration);

  void add(const RecordedRegistration& registration, safety::Timestamp t);
  void add(const RecordedGap& gap, safety::Timestamp t);
  void add(const TapedState& state, safety::Timestamp t);
  /// Input, decision and, where mode or cause have changed, a line of the log.
  void add(const TapedCycle& cycle);

  [[nodiscard]] bridge::mcap::Writer& mcap() { return mcap_; }

 private:
  struct Topic {
    std::uint16_t channel = 0;
    std::uint32_t sequence = 0;
  };
  template <typename T>
  [[nodiscard]] Topic add_topic(std::string_view topic);
  template <typename T>
  void write(Topic& topic, safety::Timestamp t, const T& value);

  bridge::mcap::Writer mcap_;
  std::chrono::nanoseconds utc_minus_monotonic_;
  Topic session_, registration_, state_, input_, decision_, gap_, log_;
  std::string bytes_;
};

}  // namespace holdfast::rt
