// SPDX-License-Identifier: Apache-2.0
// What an observer (dashboard, outlets) has heard of daemon, guard and robot, and what it may
// therefore show. Shows no permission unless daemon and guard both say so, consistently, now:
// silence shows as "no data", never as the last state heard. Pure: messages and time come in; no
// I/O. One thread.
//
// It judges what is shown, not what is done: no robot may act on it.
#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <string_view>

#include "bridge/dds/message_protection.hpp"
#include "bridge/dds/message_types.hpp"
#include "safety/end_to_end.hpp"

namespace holdfast::observer {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;

struct ObserverParameters {
  safety::ClockRelation clock = safety::ClockRelation::same_host;
  bool has_guard = true;  ///< false: the set-up runs without a guard, as its robot was told
  /// After the newest accepted message the state counts as known for this long (they come every
  /// 5 ms and every 2 ms; this program is not real-time).
  nanoseconds silence_max = milliseconds(100);
  nanoseconds health_silence_max = milliseconds(300);  ///< ten a second at least
  nanoseconds robot_silence_max = milliseconds(300);   ///< one each 50 ms
};

enum class Level : std::uint8_t { no_data, stop, hold, not_ready, permitted };
[[nodiscard]] std::string_view name(Level level) noexcept;  ///< as spelled above

/// What a person sees first. Never green without a word, never a word without a reason.
struct Shown {
  Level level = Level::no_data;
  std::string_view word;     ///< PERMITTED, HOLD, STOP, NOT PERMITTED, STOP: NO DATA
  std::string_view reason;   ///< the code's name, "guard: …" not included
  std::string_view text;     ///< the reason as a sentence
  bool is_of_guard = false;  ///< the reason is the guard's
};

/// An end of the permission shown, or a new latched stop while there is none.
struct StopEvent {
  std::int64_t t_utc_ns = 0;  ///< when it was seen
  Shown shown;
  std::uint64_t reasons = 0;            ///< all of the daemon's; 0 when it is silent
  std::uint32_t stop_id = 0;            ///< of the daemon; 0: not latched
  std::optional<nanoseconds> duration;  ///< to the next permission or event; absent while it lasts
};

/// Counts by width of one millisecond; the last bin holds all that is longer.
struct Histogram {
  static constexpr std::size_t kBins = 61;
  std::array<std::uint64_t, kBins> counts{};
  std::uint64_t count = 0;
  nanoseconds max{};
  void record(nanoseconds value) noexcept;  ///< negative ones count as 0
  /// The upper edge of the bin that holds this share of the records; 0 when there is none.
  [[nodiscard]] double percentile_ms(double share) const noexcept;
};

class ObservedState {
 public:
  static constexpr std::size_t kStopsKept = 50;

  explicit ObservedState(const ObserverParameters& parameters);

  void take(const msg::MotionStop& message, bridge::dds::Clocks now);
  void take(const msg::GuardPermission& message, bridge::dds::Clocks now);
  void take(const msg::TrackingHealth& message, bridge::dds::Clocks now);
  void take(const msg::RegistrationInfo& message, bridge::dds::Clocks now);
  void take(const msg::RobotStatus& message, bridge::dds::Clocks now);
  void take(const msg::CompensatedPose& message, bridge::dds::Clocks now);

  /// Time alone: silence is an event too. To be called at least every silence_max.
  void pass(bridge::dds::Clocks now);

  [[nodiscard]] Shown shown(nanoseconds now) const noexcept;

  // The newest accepted message, while it is fresh; null otherwise.
  [[nodiscard]] const msg::MotionStop* daemon(nanoseconds now) const noexcept;
  [[nodiscard]] const msg::GuardPermission* guard(nanoseconds now) const noexcept;
  [[nodiscard]] const msg::TrackingHealth* health(nanoseconds now) const noexcept;
  [[nodiscard]] const msg::RobotStatus* robot(nanoseconds now) const noexcept;
  /// Null also unless shown() is permitted: no pose outlives the permission it came with.
  [[nodiscard]] const msg::CompensatedPose* pose(nanoseconds now) const noexcept;
  /// Null also unless the health in force names it: an announcement alone may be old.
  [[nodiscard]] const msg::RegistrationInfo* registration(nanoseconds now) const noexcept;

  /// Newest last.
  [[nodiscard]] const std::deque<StopEvent>& stops() const noexcept { return stop_events_; }
  /// Mid-exposure to the sending of the first pose that rests on the image; only while permitted.
  [[nodiscard]] const Histogram& exposure_to_pose() const noexcept { return exposure_to_pose_; }
  [[nodiscard]] const Histogram& tracker() const noexcept { return tracker_; }
  /// Messages that failed their end-to-end check (late ones included); nothing of them is shown.
  [[nodiscard]] std::uint64_t refused() const noexcept { return refused_; }

 private:
  template <class M>
  struct Stream {
    explicit Stream(const ObserverParameters& parameters, nanoseconds silence);
    safety::Receiver receiver;
    nanoseconds silence_max;
    M newest{};
    nanoseconds t_received{};
    bool has = false;
    [[nodiscard]] const M* fresh(nanoseconds now) const noexcept {
      return has && now - t_received <= silence_max ? &newest : nullptr;
    }
  };
  template <class M>
  bool accept(Stream<M>& stream, const M& message, bridge::dds::Clocks now);

  ObserverParameters parameters_;
  Stream<msg::MotionStop> stop_;
  Stream<msg::GuardPermission> guard_;
  Stream<msg::TrackingHealth> health_;
  Stream<msg::RegistrationInfo> registration_;
  Stream<msg::RobotStatus> robot_;
  Stream<msg::CompensatedPose> pose_;
  std::deque<StopEvent> stop_events_;
  nanoseconds t_event_{};  // when the newest event began, CLOCK_MONOTONIC here
  bool was_permitted_ = false;
  std::uint32_t stop_id_ = 0;  // of the newest latched stop seen
  std::uint64_t frame_of_pose_ = 0, frame_of_health_ = 0;
  Histogram exposure_to_pose_, tracker_;
  std::uint64_t refused_ = 0;
};

}  // namespace holdfast::observer
