// SPDX-License-Identifier: Apache-2.0
#include "safety/reason.hpp"

#include <bit>

namespace holdfast::safety {
namespace {

/// First and last code of each severity.
constexpr unsigned kStopLast = 20;
constexpr unsigned kHoldLast = 44;
constexpr unsigned kReadinessLast = 55;
constexpr unsigned kAdvisoryLast = 63;

/// Bits of the codes from `first` to `last`.
constexpr std::uint64_t range(unsigned first, unsigned last) noexcept {
  return (~std::uint64_t{0} >> (63U - last)) & (~std::uint64_t{0} << first);
}

}  // namespace

Severity severity(Reason reason) noexcept {
  const auto code = static_cast<unsigned>(reason);
  if (code == 0) return Severity::none;
  if (code <= kStopLast || code > kAdvisoryLast) return Severity::stop;
  if (code <= kHoldLast) return Severity::hold;
  return code <= kReadinessLast ? Severity::readiness : Severity::advisory;
}

std::string_view name(Reason reason) noexcept {
  switch (reason) {
    case Reason::none:
      return "none";
    case Reason::operator_stop:
      return "operator_stop";
    case Reason::invalid_number:
      return "invalid_number";
    case Reason::clock_step:
      return "clock_step";
    case Reason::loop_overrun:
      return "loop_overrun";
    case Reason::second_publisher:
      return "second_publisher";
    case Reason::registration_changed:
      return "registration_changed";
    case Reason::optics_changed:
      return "optics_changed";
    case Reason::robot_fault:
      return "robot_fault";
    case Reason::drift_exceeded:
      return "drift_exceeded";
    case Reason::displacement_exceeded:
      return "displacement_exceeded";
    case Reason::speed_exceeded:
      return "speed_exceeded";
    case Reason::pose_jump:
      return "pose_jump";
    case Reason::message_corrupt:
      return "message_corrupt";
    case Reason::hold_timeout:
      return "hold_timeout";
    case Reason::internal_fault:
      return "internal_fault";
    case Reason::scale_mismatch:
      return "scale_mismatch";
    case Reason::camera_disconnected:
      return "camera_disconnected";
    case Reason::frame_late:
      return "frame_late";
    case Reason::frame_incomplete:
      return "frame_incomplete";
    case Reason::frame_gap:
      return "frame_gap";
    case Reason::frame_frozen:
      return "frame_frozen";
    case Reason::frame_dark:
      return "frame_dark";
    case Reason::frame_saturated:
      return "frame_saturated";
    case Reason::frame_time_invalid:
      return "frame_time_invalid";
    case Reason::tracking_lost:
      return "tracking_lost";
    case Reason::tracking_degraded:
      return "tracking_degraded";
    case Reason::tracking_weak:
      return "tracking_weak";
    case Reason::estimate_stale:
      return "estimate_stale";
    case Reason::covariance_exceeded:
      return "covariance_exceeded";
    case Reason::robot_silent:
      return "robot_silent";
    case Reason::microscope_missing:
      return "microscope_missing";
    case Reason::microscope_not_operational:
      return "microscope_not_operational";
    case Reason::microscope_silent:
      return "microscope_silent";
    case Reason::microscope_corrupt:
      return "microscope_corrupt";
    case Reason::can_bus_off:
      return "can_bus_off";
    case Reason::can_error_passive:
      return "can_error_passive";
    case Reason::can_overflow:
      return "can_overflow";
    case Reason::can_down:
      return "can_down";
    case Reason::optics_moving:
      return "optics_moving";
    case Reason::initialising:
      return "initialising";
    case Reason::not_registered:
      return "not_registered";
    case Reason::keyframe_unverified:
      return "keyframe_unverified";
    case Reason::not_armed:
      return "not_armed";
    case Reason::awaiting_acknowledgement:
      return "awaiting_acknowledgement";
    case Reason::not_real_time:
      return "not_real_time";
    case Reason::unsecured_transport:
      return "unsecured_transport";
    case Reason::not_recording:
      return "not_recording";
    case Reason::optics_unwatched:
      return "optics_unwatched";
    case Reason::virtual_microscope:
      return "virtual_microscope";
  }
  return "unknown";
}

Reason ReasonSet::primary() const noexcept {
  return bits_ == 0 ? Reason::none : static_cast<Reason>(std::countr_zero(bits_));
}

ReasonSet ReasonSet::with(Severity severity) const noexcept {
  switch (severity) {
    case Severity::none:
      return ReasonSet{};
    case Severity::stop:
      return ReasonSet(bits_ & range(1, kStopLast));
    case Severity::hold:
      return ReasonSet(bits_ & range(kStopLast + 1, kHoldLast));
    case Severity::readiness:
      return ReasonSet(bits_ & range(kHoldLast + 1, kReadinessLast));
    case Severity::advisory:
      return ReasonSet(bits_ & range(kReadinessLast + 1, kAdvisoryLast));
  }
  return *this;
}

}  // namespace holdfast::safety
