// SPDX-License-Identifier: Apache-2.0
// Why motion is not permitted. The codes are on the wire: stable, never reused. Among simultaneous
// reasons the one with the lowest code is the primary one, so a stop outranks a hold.
#pragma once

#include <cstdint>
#include <string_view>

namespace holdfast::safety {

enum class Severity : std::uint8_t {
  none,  ///< no reason
  stop,  ///< permission withdrawn and latched: operator acknowledgement and a drift check end it
  hold,  ///< permission withdrawn, may recover by itself within Limits::hold_max
  readiness,  ///< permission has not been asked for, or cannot be given yet
  advisory    ///< does not withdraw permission; published with every health message
};

enum class Reason : std::uint8_t {
  none = 0,
  // stop: 1-20
  operator_stop = 1,           ///< the operator commanded a stop
  invalid_number = 2,          ///< a NaN, infinity or non-rotation reached the gate
  clock_step = 3,              ///< time went backwards, or UTC and monotonic time parted
  loop_overrun = 4,            ///< the control loop missed its grid by more than its limit
  second_publisher = 5,        ///< another writer of poses is on the domain
  registration_changed = 6,    ///< the registration was replaced or withdrawn while in use
  optics_changed = 7,          ///< zoom or focus differ from those of the registration
  robot_fault = 8,             ///< the robot reports a fault
  drift_exceeded = 9,          ///< frame-to-frame and keyframe-anchored motion disagree
  displacement_exceeded = 10,  ///< the site has left the range the registration is valid for
  speed_exceeded = 11,         ///< the site moves faster than can be compensated
  pose_jump = 12,              ///< an estimate contradicts the motion filter
  message_corrupt = 13,        ///< an input message failed its end-to-end check
  hold_timeout = 14,           ///< a hold did not recover in time
  internal_fault = 15,         ///< an invariant of ours is broken, or an event queue overflowed
  scale_mismatch = 16,         ///< the image's scale is not the one that the zoom encoder gives
  // hold: 21-44
  camera_disconnected = 21,
  frame_late = 22,        ///< the next frame's deadline passed
  frame_incomplete = 23,  ///< packets of the frame are missing
  frame_gap = 24,         ///< frame ids skipped
  frame_frozen = 25,      ///< the image repeats bit for bit
  frame_dark = 26,
  frame_saturated = 27,
  frame_time_invalid = 28,  ///< the frame's time stamp repeats, goes back, or lies in the future
  tracking_lost = 29,
  tracking_degraded = 30,
  tracking_weak = 31,               ///< too few inliers, or bunched in one corner
  estimate_stale = 32,              ///< the newest estimate is older than may be extrapolated
  covariance_exceeded = 33,         ///< predicted uncertainty at the target is over its limit
  robot_silent = 34,                ///< no fresh status from the robot
  microscope_missing = 35,          ///< no heartbeat of its node, also when there never was one
  microscope_not_operational = 36,  ///< the node beats, but says that it boots or is stopped
  microscope_silent = 37,           ///< zoom and focus are not told, or not read by us, in time
  microscope_corrupt = 38,          ///< a message of it failed its check, or was lost or repeated
  can_bus_off = 39,
  can_error_passive = 40,
  can_overflow = 41,   ///< frames were lost on our side
  can_down = 42,       ///< the network interface is down or gone
  optics_moving = 43,  ///< a drive of the microscope moves
  // readiness: 45-55
  initialising = 45,
  not_registered = 46,
  keyframe_unverified = 47,  ///< the live image has not yet been matched to the keyframe
  not_armed = 48,
  awaiting_acknowledgement = 49,
  // advisory: 56-63
  not_real_time = 56,        ///< running without real-time scheduling, by explicit request
  unsecured_transport = 57,  ///< DDS Security is off
  not_recording = 58,        ///< a recording was asked for, and the disk refuses it
  optics_unwatched = 59,     ///< no encoder is read: the configuration declares fixed optics
  virtual_microscope = 60    ///< zoom and focus come from a local bus, not from CAN
};

/// By range of codes; stop for a code that no range holds, so that an unknown one is not ignored.
[[nodiscard]] Severity severity(Reason reason) noexcept;
/// The reason's name as spelled above; "unknown" for a code that is not listed.
[[nodiscard]] std::string_view name(Reason reason) noexcept;

/// A set of reasons; bit n stands for code n. Trivially copyable; the same 64 bits are on the wire.
class ReasonSet {
 public:
  constexpr ReasonSet() noexcept = default;
  /// Bit 0 stands for no reason and is dropped.
  constexpr explicit ReasonSet(std::uint64_t bits) noexcept : bits_(bits & ~std::uint64_t{1}) {}
  constexpr void insert(Reason reason) noexcept { bits_ |= bit(reason); }
  constexpr void insert(ReasonSet other) noexcept { bits_ |= other.bits_; }
  constexpr void erase(Reason reason) noexcept { bits_ &= ~bit(reason); }
  [[nodiscard]] constexpr bool contains(Reason reason) const noexcept {
    return (bits_ & bit(reason)) != 0;
  }
  [[nodiscard]] constexpr bool empty() const noexcept { return bits_ == 0; }
  [[nodiscard]] constexpr std::uint64_t bits() const noexcept { return bits_; }
  /// The reason with the lowest code, Reason::none if empty.
  [[nodiscard]] Reason primary() const noexcept;
  /// The subset of one severity.
  [[nodiscard]] ReasonSet with(Severity severity) const noexcept;
  friend constexpr bool operator==(ReasonSet, ReasonSet) noexcept = default;

 private:
  static constexpr std::uint64_t bit(Reason reason) noexcept {
    const auto code = static_cast<unsigned>(reason);
    return code == 0 || code > 63 ? 0 : std::uint64_t{1} << code;
  }
  std::uint64_t bits_ = 0;
};

}  // namespace holdfast::safety
