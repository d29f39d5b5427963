// SPDX-License-Identifier: Apache-2.0
#include "safety/monitors.hpp"

#include <cmath>

#include "safety/composition.hpp"
#include "safety/numbers.hpp"

namespace holdfast::safety {
namespace {

bool is_stale(const Limits& limits, const TrackingInput& tracking, Timestamp now) noexcept {
  return elapsed(tracking.t_exposure, now) > limits.estimate_age_max;
}

bool has_valid_numbers(const PredictedPose& prediction) noexcept {
  return is_rigid(prediction.T_camera_site) && is_covariance(prediction.covariance) &&
         is_magnitude(prediction.speed_mm_per_s);
}

bool has_valid_numbers(const RegistrationInput& registration) noexcept {
  return is_rigid(registration.T_site_ct) && is_covariance(registration.covariance) &&
         registration.p_target_site_mm.allFinite() && is_magnitude(registration.zoom) &&
         is_magnitude(registration.focus_mm);
}

bool has_valid_numbers(const TrackingInput& tracking) noexcept {
  return is_magnitude(tracking.inlier_spread) && tracking.inlier_spread <= 1 &&
         (!tracking.has_drift || is_magnitude(tracking.drift_mm)) && is_magnitude(tracking.scale);
}

bool has_valid_numbers(const HandEyeSigma& sigma) noexcept {
  // Zero is a statement here: the transform is exact, or its error is given by the other two.
  return is_magnitude(sigma.t_mm) && is_magnitude(sigma.r_rad) &&
         (sigma.covariance.isZero(0) || is_covariance(sigma.covariance));
}

bool has_valid_numbers(const OpticsInput& optics) noexcept {
  return !optics.is_known || (is_magnitude(optics.zoom) && is_magnitude(optics.focus_mm));
}

/// What the reader's newest report is worth.
ReasonSet report_reasons(const Limits& limits, const OpticsInput& optics, Timestamp now) noexcept {
  ReasonSet reasons(optics.faults.bits() & kOpticsReasons.bits());
  if (reasons != optics.faults) reasons.insert(Reason::internal_fault);
  if (!optics.has_report) reasons.insert(Reason::microscope_missing);
  const Duration age = elapsed(optics.t_report, now);
  // A report from the future would never grow old.
  if (optics.has_report && (age > limits.optics_age_max || age < -limits.frame_future_max)) {
    reasons.insert(Reason::microscope_silent);
  }
  if (optics.is_moving) reasons.insert(Reason::optics_moving);
  if (!optics.is_known && reasons.empty()) reasons.insert(Reason::microscope_silent);
  return reasons;
}

/// How much larger than in the keyframe the site must look if it has not come nearer.
double expected_scale(const OpticsInput& optics, const RegistrationInput& registration) noexcept {
  const bool is_read = !optics.is_declared_fixed && optics.is_known;
  return is_read ? optics.zoom / registration.zoom : 1;
}

}  // namespace

ReasonSet operator_reasons(const OperatorInput& command) noexcept {
  ReasonSet reasons;
  if (command.command == Command::stop) reasons.insert(Reason::operator_stop);
  if (command.command > Command::confirm) reasons.insert(Reason::message_corrupt);
  return reasons;
}

ReasonSet time_reasons(const Limits& limits, const Inputs& inputs,
                       const GateState& state) noexcept {
  ReasonSet reasons;
  const bool is_backwards = state.has_cycle && inputs.now < state.t_last_cycle;
  const Duration divergence = inputs.loop.clock_divergence;
  if (is_backwards || divergence > limits.clock_step_max || divergence < -limits.clock_step_max) {
    reasons.insert(Reason::clock_step);
  }
  if (inputs.loop.wake_lateness > limits.loop_lateness_max) reasons.insert(Reason::loop_overrun);
  return reasons;
}

ReasonSet report_reasons(const LoopInput& loop) noexcept {
  ReasonSet reasons;
  if (loop.second_publisher) reasons.insert(Reason::second_publisher);
  if (loop.message_corrupt) reasons.insert(Reason::message_corrupt);
  if (loop.internal_fault) reasons.insert(Reason::internal_fault);
  return reasons;
}

ReasonSet number_reasons(const Inputs& inputs) noexcept {
  const bool has_motion = inputs.tracking.has_estimate && !inputs.tracking.is_lost;
  const bool is_valid =
      is_rigid(inputs.T_robot_camera) && has_valid_numbers(inputs.hand_eye_sigma) &&
      (!inputs.prediction || has_valid_numbers(*inputs.prediction)) &&
      (!inputs.registration.is_loaded || has_valid_numbers(inputs.registration)) &&
      (!has_motion || has_valid_numbers(inputs.tracking)) &&
      (inputs.optics.is_declared_fixed || has_valid_numbers(inputs.optics));
  ReasonSet reasons;
  if (!is_valid) reasons.insert(Reason::invalid_number);
  return reasons;
}

ReasonSet registration_reasons(const RegistrationInput& registration,
                               const GateState& state) noexcept {
  ReasonSet reasons;
  const bool is_same = registration.is_loaded && registration.id == state.registration_id;
  if (state.is_keyframe_verified && !is_same) reasons.insert(Reason::registration_changed);
  return reasons;
}

ReasonSet keyframe_reasons(const RegistrationInput& registration,
                           const TrackingInput& tracking) noexcept {
  ReasonSet reasons;
  const bool is_other = registration.is_loaded && tracking.has_estimate &&
                        tracking.registration_id != registration.id;
  if (is_other) reasons.insert(Reason::tracking_lost);
  return reasons;
}

ReasonSet camera_reasons(const Limits& limits, const CameraInput& camera, Timestamp now) noexcept {
  const ReasonSet stops = camera.faults.with(Severity::stop);
  ReasonSet reasons = camera.faults.with(Severity::hold);
  reasons.insert(stops);
  if (reasons != camera.faults) reasons.insert(Reason::internal_fault);
  if (!camera.is_connected) reasons.insert(Reason::camera_disconnected);
  const Duration age = elapsed(camera.t_last_frame_received, now);
  if (!camera.has_frame || age > limits.frame_period + limits.frame_lateness) {
    reasons.insert(Reason::frame_late);
  }
  if (camera.has_frame && age < -limits.frame_future_max) {
    reasons.insert(Reason::frame_time_invalid);
  }
  return reasons;
}

ReasonSet tracking_reasons(const Limits& limits, const TrackingInput& tracking,
                           Timestamp now) noexcept {
  ReasonSet reasons;
  if (!tracking.has_estimate || tracking.is_lost) {
    reasons.insert(Reason::tracking_lost);
    return reasons;
  }
  if (tracking.is_degraded) reasons.insert(Reason::tracking_degraded);
  if (tracking.inliers < limits.inliers_min || !tracking.has_drift ||
      falls_short(tracking.inlier_spread, limits.inlier_spread_min)) {
    reasons.insert(Reason::tracking_weak);
  }
  if (is_stale(limits, tracking, now)) reasons.insert(Reason::estimate_stale);
  if (elapsed(now, tracking.t_exposure) > limits.frame_future_max) {
    reasons.insert(Reason::frame_time_invalid);
  }
  if (tracking.contradicts_filter) reasons.insert(Reason::pose_jump);
  if (tracking.has_drift && exceeds(tracking.drift_mm, limits.drift_max_mm)) {
    reasons.insert(Reason::drift_exceeded);
  }
  return reasons;
}

ReasonSet motion_reasons(const Limits& limits, const Inputs& inputs) noexcept {
  ReasonSet reasons;
  if (!inputs.prediction) {
    reasons.insert(Reason::tracking_lost);
    return reasons;
  }
  if (!inputs.registration.is_loaded) return reasons;
  if (inputs.tracking.has_estimate && is_stale(limits, inputs.tracking, inputs.now)) return reasons;
  const PredictedPose& prediction = *inputs.prediction;
  const Eigen::Isometry3d& T_camera_site = prediction.T_camera_site;
  const Eigen::Vector3d& p_target_site_mm = inputs.registration.p_target_site_mm;
  if (exceeds(displacement_mm(T_camera_site, p_target_site_mm), limits.displacement_max_mm) ||
      exceeds(angle_rad(T_camera_site.linear()), limits.rotation_max_rad)) {
    reasons.insert(Reason::displacement_exceeded);
  }
  if (exceeds(std::abs(prediction.speed_mm_per_s), limits.speed_max_mm_per_s)) {
    reasons.insert(Reason::speed_exceeded);
  }
  if (exceeds(judged_sigma_mm(inputs), limits.sigma_target_max_mm)) {
    reasons.insert(Reason::covariance_exceeded);
  }
  return reasons;
}

ReasonSet robot_reasons(const Limits& limits, const RobotInput& robot, Timestamp now) noexcept {
  ReasonSet reasons;
  if (robot.has_status && robot.has_fault) reasons.insert(Reason::robot_fault);
  const Duration age = elapsed(robot.t_last_status, now);
  // A status from the future would never grow old.
  if (!robot.has_status || age > limits.robot_silence_max || age < -limits.frame_future_max) {
    reasons.insert(Reason::robot_silent);
  }
  return reasons;
}

ReasonSet optics_reasons(const Limits& limits, const Inputs& inputs) noexcept {
  const OpticsInput& optics = inputs.optics;
  const RegistrationInput& registration = inputs.registration;
  ReasonSet reasons;
  if (!optics.is_declared_fixed) reasons = report_reasons(limits, optics, inputs.now);
  if (!registration.is_loaded) return reasons;
  const bool is_read = !optics.is_declared_fixed && optics.is_known;
  if (is_read &&
      (exceeds(std::abs(optics.zoom - registration.zoom), limits.zoom_tolerance) ||
       exceeds(std::abs(optics.focus_mm - registration.focus_mm), limits.focus_tolerance_mm))) {
    reasons.insert(Reason::optics_changed);
  }
  const TrackingInput& tracking = inputs.tracking;
  const double expected = expected_scale(optics, registration);
  if (tracking.has_estimate && !tracking.is_lost &&
      exceeds(std::abs(tracking.scale - expected), limits.scale_mismatch_max * expected)) {
    reasons.insert(Reason::scale_mismatch);
  }
  return reasons;
}

ReasonSet observed_reasons(const Limits& limits, const Inputs& inputs,
                           const GateState& state) noexcept {
  ReasonSet reasons = operator_reasons(inputs.operator_command);
  reasons.insert(time_reasons(limits, inputs, state));
  reasons.insert(report_reasons(inputs.loop));
  reasons.insert(number_reasons(inputs));
  reasons.insert(registration_reasons(inputs.registration, state));
  reasons.insert(keyframe_reasons(inputs.registration, inputs.tracking));
  reasons.insert(camera_reasons(limits, inputs.camera, inputs.now));
  reasons.insert(tracking_reasons(limits, inputs.tracking, inputs.now));
  reasons.insert(motion_reasons(limits, inputs));
  reasons.insert(optics_reasons(limits, inputs));
  reasons.insert(robot_reasons(limits, inputs.robot, inputs.now));
  return reasons;
}

}  // namespace holdfast::safety
