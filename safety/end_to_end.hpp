// SPDX-License-Identifier: Apache-2.0
// End-to-end protection of messages: what the sender adds and what the receiver checks, independent
// of the transport. Detects corruption, repetition, loss, reordering, delay, masquerade, insertion
// and silence. Pure: time is passed in. std only (the robot-side client library links this).
#pragma once

#include <chrono>
#include <cstdint>
#include <string_view>

namespace holdfast::safety {

inline constexpr std::uint8_t kProtectionVersion = 1;

/// Which message a protected payload is; part of the CRC, so that no topic can pose as another.
enum class DataId : std::uint8_t {
  compensated_pose = 1,
  motion_stop = 2,
  tracking_health = 3,
  registration_info = 4,
  robot_status = 5,
  operator_command = 6,
  guard_permission = 7
};

/// Travels with each message. The CRC covers data id, all fields below except itself, and the
/// payload.
struct Protection {
  std::uint8_t version = kProtectionVersion;
  DataId data_id{};
  std::uint32_t source = 0;         ///< random per process start; 0 is invalid
  std::uint32_t counter = 0;        ///< +1 per message of this source and data id, wraps
  std::int64_t t_monotonic_ns = 0;  ///< sender's CLOCK_MONOTONIC at sending
  std::int64_t t_utc_ns = 0;        ///< sender's CLOCK_REALTIME at sending
  std::uint32_t validity_us = 0;    ///< may be acted on until t + validity
  std::uint32_t crc32c = 0;
};

enum class Verdict : std::uint8_t {
  accepted,
  bad_version,
  bad_data_id,  ///< a message of another topic
  bad_source,   ///< zero, or a second source while the first is alive
  bad_crc,
  repeated,      ///< counter not advanced
  skipped,       ///< counter advanced by more than max_counter_step
  expired,       ///< older than its validity at reception
  from_future,   ///< stamped later than now + future_tolerance
  time_reversed  ///< stamped earlier than the previous accepted message
};
[[nodiscard]] std::string_view name(Verdict verdict) noexcept;

/// How receiver and sender clocks relate.
enum class ClockRelation : std::uint8_t {
  same_host,        ///< one CLOCK_MONOTONIC: age is checked on it
  synchronised_utc  ///< separate hosts with PTP/NTP: age is checked on UTC
};

struct ReceiverParameters {
  ClockRelation clock = ClockRelation::same_host;
  std::uint32_t max_counter_step = 1;  ///< 1: no loss tolerated
  std::chrono::nanoseconds future_tolerance = std::chrono::milliseconds(1);
  std::chrono::nanoseconds source_timeout =
      std::chrono::milliseconds(100);  ///< silence after which a new source may take over
  std::chrono::nanoseconds max_validity =
      std::chrono::milliseconds(20);  ///< a longer claim is cut to this
};

/// The receiver's memory for one data id. One thread.
class Receiver {
 public:
  Receiver(DataId data_id, ReceiverParameters parameters) noexcept
      : data_id_(data_id), parameters_(parameters) {}

  /// Checks one message. `computed_crc` is over the received bytes. On anything but `accepted` the
  /// message must not be used. A skipped counter on an otherwise good message resynchronises (the
  /// message after it can be accepted), every other refusal leaves the memory as it was. Of several
  /// faults the verdict names the first in this order: version, CRC, data id, source, repetition,
  /// expiry, future, reversal, skip. Exactly at a limit is accepted. noexcept, allocation-free.
  [[nodiscard]] Verdict check(const Protection& protection, std::uint32_t computed_crc,
                              std::chrono::nanoseconds now_monotonic,
                              std::chrono::nanoseconds now_utc) noexcept;

  /// Until when, on the receiver's CLOCK_MONOTONIC, the last accepted message may be acted on:
  /// reception + (validity - age at reception), never beyond reception + max_validity. Before the
  /// first acceptance: the epoch, so that nothing is ever valid by default.
  [[nodiscard]] std::chrono::nanoseconds valid_until() const noexcept { return valid_until_; }
  [[nodiscard]] std::uint32_t source() const noexcept { return source_; }

 private:
  DataId data_id_;
  ReceiverParameters parameters_;
  std::uint32_t source_ = 0;
  std::uint32_t counter_ = 0;
  std::chrono::nanoseconds t_last_sent_{};
  std::chrono::nanoseconds t_last_heard_{};  ///< reception of the last accepted or skipped one
  std::chrono::nanoseconds valid_until_{};
};

}  // namespace holdfast::safety
