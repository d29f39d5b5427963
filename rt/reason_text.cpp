// SPDX-License-Identifier: Apache-2.0
#include "rt/reason_text.hpp"

namespace holdfast::rt {

using guard::GuardCause;
using safety::Reason;
using safety::Severity;

std::string_view sentence(Reason reason) noexcept {
  switch (reason) {
    case Reason::none:
      return "No reason";
    case Reason::operator_stop:
      return "The operator commanded a stop";
    case Reason::invalid_number:
      return "A number that is none reached the gate";
    case Reason::clock_step:
      return "The clock was set, or went backwards";
    case Reason::loop_overrun:
      return "The control loop was late";
    case Reason::second_publisher:
      return "Another program publishes poses on this domain";
    case Reason::registration_changed:
      return "The registration was replaced or withdrawn while in use";
    case Reason::optics_changed:
      return "Zoom or focus differ from those of the registration";
    case Reason::robot_fault:
      return "The robot reports a fault";
    case Reason::drift_exceeded:
      return "The two ways of measuring the motion disagree: drift";
    case Reason::displacement_exceeded:
      return "The site has left the range that the registration is valid for";
    case Reason::speed_exceeded:
      return "The site moves faster than can be compensated";
    case Reason::pose_jump:
      return "An estimate contradicts the motion before it";
    case Reason::message_corrupt:
      return "A message to the daemon failed its check";
    case Reason::hold_timeout:
      return "A hold did not recover in time";
    case Reason::internal_fault:
      return "The daemon found a fault of its own";
    case Reason::scale_mismatch:
      return "The image's scale is not the one that the zoom encoder gives";
    case Reason::camera_disconnected:
      return "The camera is not connected";
    case Reason::frame_late:
      return "The next camera image is overdue";
    case Reason::frame_incomplete:
      return "A part of the camera image is missing";
    case Reason::frame_gap:
      return "Camera images are missing";
    case Reason::frame_frozen:
      return "The camera image repeats";
    case Reason::frame_dark:
      return "The camera image is too dark";
    case Reason::frame_saturated:
      return "The camera image is overexposed";
    case Reason::frame_time_invalid:
      return "The camera image's time is wrong";
    case Reason::tracking_lost:
      return "The site is not found in the image";
    case Reason::tracking_degraded:
      return "The site is found badly";
    case Reason::tracking_weak:
      return "Too few features agree, or only in one corner";
    case Reason::estimate_stale:
      return "The newest estimate is too old";
    case Reason::covariance_exceeded:
      return "The position of the target is too uncertain";
    case Reason::robot_silent:
      return "The robot sends no status";
    case Reason::microscope_missing:
      return "The microscope does not answer on CAN";
    case Reason::microscope_not_operational:
      return "The microscope says that it is not ready";
    case Reason::microscope_silent:
      return "The microscope does not tell zoom and focus";
    case Reason::microscope_corrupt:
      return "A message of the microscope was wrong";
    case Reason::can_bus_off:
      return "The CAN controller is off the bus";
    case Reason::can_error_passive:
      return "The CAN bus has errors";
    case Reason::can_overflow:
      return "CAN messages were lost";
    case Reason::can_down:
      return "The CAN interface is down";
    case Reason::optics_moving:
      return "Zoom or focus is moving";
    case Reason::initialising:
      return "The daemon is starting";
    case Reason::not_registered:
      return "There is no registration";
    case Reason::keyframe_unverified:
      return "The live image has not been matched to the keyframe yet";
    case Reason::not_armed:
      return "Ready, not armed";
    case Reason::awaiting_acknowledgement:
      return "The stop waits for its acknowledgement";
    case Reason::not_real_time:
      return "Running without real-time scheduling, as allowed";
    case Reason::unsecured_transport:
      return "Messages are not encrypted: DDS Security is off";
    case Reason::not_recording:
      return "The recording does not reach the disk";
    case Reason::optics_unwatched:
      return "No zoom encoder is read: the optics are declared fixed";
    case Reason::virtual_microscope:
      return "Zoom and focus come from a simulated microscope";
  }
  return "A reason that this program does not know";
}

std::string_view sentence(GuardCause cause) noexcept {
  switch (cause) {
    case GuardCause::none:
      return "No reason";
    case GuardCause::robot_disobeys:
      return "The robot moves although the guard does not permit it";
    case GuardCause::pose_implausible:
      return "A pose contradicts registration or tracking";
    case GuardCause::pose_jump:
      return "The target moved faster than can be";
    case GuardCause::message_bad:
      return "A message failed its check at the guard";
    case GuardCause::daemon_silent:
      return "The guard hears no daemon";
    case GuardCause::health_silent:
      return "The guard hears no tracking health";
    case GuardCause::pose_silent:
      return "The guard hears no poses";
    case GuardCause::pose_old:
      return "The poses rest on too old an image";
    case GuardCause::robot_silent:
      return "The guard hears no robot";
    case GuardCause::robot_fault:
      return "The robot reports a fault";
    case GuardCause::tracking_lost:
      return "The tracker has lost the site";
    case GuardCause::not_registered:
      return "No registration is announced, or another one";
    case GuardCause::daemon_not_permitting:
      return "The daemon does not permit motion";
    case GuardCause::recovering:
      return "All is well again, not yet for long enough";
  }
  return "A reason of the guard that this program does not know";
}

std::string_view name(Severity severity) noexcept {
  switch (severity) {
    case Severity::none:
      return "none";
    case Severity::stop:
      return "stop";
    case Severity::hold:
      return "hold";
    case Severity::readiness:
      return "readiness";
    case Severity::advisory:
      return "advisory";
  }
  return "unknown";
}

}  // namespace holdfast::rt
