// SPDX-License-Identifier: Apache-2.0
// The client's decision, without DDS: messages and time in, permission out. Pure: no clock, no I/O,
// no heap; noexcept. One thread.
#pragma once

#include <chrono>
#include <cstdint>

#include "bridge/client/client.hpp"
#include "bridge/dds/message_protection.hpp"
#include "bridge/dds/message_types.hpp"
#include "safety/end_to_end.hpp"

namespace holdfast::client {

using bridge::dds::Clocks;

class PermissionCore {
 public:
  explicit PermissionCore(const Parameters& parameters) noexcept;

  /// One message as received; `now` is this host's clocks after its reception.
  void take(const msg::MotionStop& message, Clocks now) noexcept;
  void take(const msg::CompensatedPose& message, Clocks now) noexcept;
  void take(const msg::GuardPermission& message, Clocks now) noexcept;

  /// The answer at `now` (CLOCK_MONOTONIC).
  [[nodiscard]] Permission decide(std::chrono::nanoseconds now) const noexcept;

  [[nodiscard]] const Counts& counts() const noexcept { return counts_; }
  [[nodiscard]] Refusal newest_refusal() const noexcept { return newest_refusal_; }

 private:
  /// One topic: its end-to-end memory, and whether what it says is believed.
  struct Stream {
    safety::Receiver receiver;
    Refusal fault;  ///< why it is not believed; none: it is
    int good_messages = 0;
    std::uint32_t source = 0;
  };

  template <class M>
  [[nodiscard]] Refusal examine(const M& message, Stream& stream, Clocks now) noexcept;
  [[nodiscard]] bool settle(Stream& stream, Refusal refusal, std::uint32_t source,
                            std::uint64_t& accepted, std::uint64_t& refused) noexcept;
  [[nodiscard]] Refusal content_fault(const msg::CompensatedPose& message) const noexcept;
  [[nodiscard]] std::int64_t to_local(std::int64_t t_ns, const msg::Protection& protection,
                                      Clocks now) const noexcept;
  [[nodiscard]] Refusal guard_refusal_at(std::chrono::nanoseconds now) const noexcept;
  [[nodiscard]] Refusal refusal_at(std::chrono::nanoseconds now) const noexcept;

  Parameters parameters_;
  Stream stops_;
  Stream poses_;
  Stream guards_;
  bool is_vouched_ = false;           ///< by the guard's newest message
  std::uint8_t guard_cause_ = 0;      ///< of it
  std::uint32_t vouched_source_ = 0;  ///< whose poses it vouches for
  std::int64_t t_vouched_ns_ = 0;     ///< since when, control PC's CLOCK_MONOTONIC
  StopState stop_;
  Pose pose_;
  std::int64_t t_pose_sent_ns_ = 0;  ///< control PC's CLOCK_MONOTONIC
  bool has_second_source_ = false;
  std::chrono::nanoseconds t_second_source_{};
  Counts counts_;
  Refusal newest_refusal_ = Refusal::none;
};

}  // namespace holdfast::client
