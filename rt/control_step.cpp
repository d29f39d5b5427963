// SPDX-License-Identifier: Apache-2.0
#include "rt/control_step.hpp"

#include <algorithm>
#include <cmath>

#include "safety/composition.hpp"

namespace holdfast::rt {
namespace {

using safety::Reason;
using safety::Timestamp;

/// What happened in this cycle only.
struct Events {
  Timestamp t_fault_received{};  ///< of the first arrival that carries a fault
  bool has_fault_arrival = false;
};

bool brings_frame(const FrameArrival& arrival) noexcept {
  return arrival.is_frame && !arrival.faults.contains(Reason::frame_incomplete) &&
         !arrival.faults.contains(Reason::frame_late) &&
         !arrival.faults.contains(Reason::camera_disconnected);
}

void take_arrivals(const Readings& readings, ControlState& state, Events& events) noexcept {
  state.camera.faults = {};
  const std::size_t count = std::min(readings.arrival_count, Readings::kMaxArrivals);
  for (std::size_t i = 0; i < count; ++i) {
    const FrameArrival& arrival = readings.arrivals[i];
    state.camera.faults.insert(arrival.faults);
    state.camera.is_connected = arrival.is_connected;
    if (!arrival.is_connected) state.camera.faults.insert(Reason::camera_disconnected);
    const bool is_faulty = !arrival.faults.empty() || !arrival.is_connected;
    if (is_faulty && !events.has_fault_arrival) {
      events.has_fault_arrival = true;
      events.t_fault_received = arrival.t_received;
    }
    if (arrival.is_connected && brings_frame(arrival)) {
      state.camera.has_frame = true;
      state.camera.t_last_frame_received = arrival.t_received;
    }
  }
}

void follow_registration(const safety::RegistrationInput& registration,
                         ControlState& state) noexcept {
  const bool is_same = registration.is_loaded == state.has_registration &&
                       (!registration.is_loaded || registration.id == state.registration_id);
  if (is_same) return;
  state.has_registration = registration.is_loaded;
  state.registration_id = registration.is_loaded ? registration.id : 0;
  state.filter.reset();
  state.tracking = {};
}

safety::TrackingInput tracking_input(const StampedEstimate& estimate) noexcept {
  const perception::MotionEstimate& motion = estimate.motion;
  safety::TrackingInput tracking;
  tracking.has_estimate = true;
  tracking.is_new = true;
  tracking.is_lost = motion.status == perception::TrackingStatus::lost;
  tracking.is_degraded = motion.status == perception::TrackingStatus::degraded;
  tracking.registration_id = estimate.registration_id;
  tracking.t_exposure = motion.t_exposure;
  tracking.inliers = motion.inliers;
  tracking.inlier_spread = motion.inlier_spread;
  tracking.has_drift = motion.has_drift;
  tracking.drift_mm = motion.drift_um * 1e-3;
  tracking.scale = motion.scale;
  return tracking;
}

/// Corrects the filter; false when the estimate is unfit even to be reported as the newest one.
bool take_motion(const StampedEstimate& estimate, Timestamp now,
                 const ControlParameters& parameters, ControlState& state) noexcept {
  const perception::MotionEstimate& motion = estimate.motion;
  const bool is_lost = motion.status == perception::TrackingStatus::lost;
  const bool is_future = motion.t_exposure > now + parameters.limits.frame_future_max;
  const bool is_of_other_keyframe =
      state.has_registration && estimate.registration_id != state.registration_id;
  safety::TrackingInput tracking = tracking_input(estimate);
  if (!is_lost && !is_future && !is_of_other_keyframe) {
    using Correction = PoseFilter::Correction;
    const Correction correction = state.filter.correct(motion, parameters.filter);
    if (correction == Correction::not_newer || correction == Correction::invalid_number) {
      state.camera.faults.insert(correction == Correction::not_newer ? Reason::frame_time_invalid
                                                                     : Reason::invalid_number);
      return false;
    }
    tracking.contradicts_filter = correction == Correction::contradicts;
  }
  state.tracking = tracking;
  return true;
}

void take_estimate(const Readings& readings, Timestamp now, const ControlParameters& parameters,
                   ControlState& state, Events& events) noexcept {
  state.tracking.is_new = false;
  if (!readings.estimate) return;
  const StampedEstimate& estimate = *readings.estimate;
  if (take_motion(estimate, now, parameters, state)) {
    state.newest_frame = estimate.frame;
    state.t_newest_frame_received = estimate.t_frame_received;
    state.t_estimate_published = estimate.t_published;
  } else if (!events.has_fault_arrival) {
    events.has_fault_arrival = true;
    events.t_fault_received = estimate.t_published;
  }
}

safety::Inputs gate_inputs(Timestamp now, const ControlParameters& parameters,
                           const Readings& readings, const ControlState& state) noexcept {
  safety::Inputs inputs;
  inputs.now = now;
  inputs.camera = state.camera;
  inputs.tracking = state.tracking;
  const Timestamp t_pose = now + parameters.limits.pose_lead;
  inputs.prediction =
      readings.registration.is_loaded
          ? state.filter.predict(t_pose, parameters.filter, readings.registration.p_target_site_mm)
          : state.filter.predict(t_pose, parameters.filter);
  inputs.registration = readings.registration;
  inputs.optics = state.optics;
  inputs.optics.is_declared_fixed = parameters.optics_are_fixed;
  inputs.robot = state.robot;
  inputs.operator_command = readings.operator_command;
  inputs.loop = readings.loop;
  if (readings.arrival_count > Readings::kMaxArrivals) inputs.loop.internal_fault = true;
  inputs.T_robot_camera = parameters.T_robot_camera;
  inputs.hand_eye_sigma = parameters.hand_eye_sigma;
  return inputs;
}

/// When the cause of a change was there to be seen; `now` for what has no earlier trace.
Timestamp evidence(Reason cause, Timestamp now, const safety::Limits& limits,
                   const safety::Inputs& inputs, const ControlState& state,
                   const Events& events) noexcept {
  switch (cause) {
    case Reason::frame_late:
      if (events.has_fault_arrival && inputs.camera.faults.contains(Reason::frame_late)) break;
      if (!inputs.camera.has_frame) return now;
      return inputs.camera.t_last_frame_received + limits.frame_period + limits.frame_lateness;
    case Reason::estimate_stale:
      return inputs.tracking.t_exposure + limits.estimate_age_max;
    case Reason::robot_silent:
      return inputs.robot.has_status ? inputs.robot.t_last_status + limits.robot_silence_max : now;
    case Reason::robot_fault:
      return inputs.robot.t_last_status;
    case Reason::hold_timeout:
      return state.gate.t_hold_entered + limits.hold_max;
    case Reason::loop_overrun:
      return now - inputs.loop.wake_lateness + limits.loop_lateness_max;
    case Reason::tracking_lost:
    case Reason::tracking_degraded:
    case Reason::tracking_weak:
    case Reason::drift_exceeded:
    case Reason::displacement_exceeded:
    case Reason::speed_exceeded:
    case Reason::pose_jump:
    case Reason::covariance_exceeded:
    case Reason::scale_mismatch:
      return inputs.tracking.is_new ? state.t_estimate_published : now;
    case Reason::microscope_silent:
      if (!inputs.optics.faults.contains(cause) && inputs.optics.is_known)
        return inputs.optics.t_report + limits.optics_age_max;
      return inputs.optics.has_report ? inputs.optics.t_report : now;
    case Reason::optics_changed:
    case Reason::optics_moving:
      return inputs.optics.t_report;
    default:
      break;
  }
  if (inputs.optics.faults.contains(cause)) return inputs.optics.t_report;
  return inputs.camera.faults.contains(cause) && events.has_fault_arrival ? events.t_fault_received
                                                                          : now;
}

}  // namespace

ControlOutput control_step(Timestamp now, const ControlParameters& parameters,
                           const Readings& readings, ControlState& state) noexcept {
  // 1. Fold in what arrived.
  Events events;
  take_arrivals(readings, state, events);
  follow_registration(readings.registration, state);
  take_estimate(readings, now, parameters, state, events);
  if (readings.robot_status) state.robot = *readings.robot_status;
  if (readings.optics) state.optics = *readings.optics;

  // 2. Predict to the instant of use and ask the gate.
  const safety::Inputs inputs = gate_inputs(now, parameters, readings, state);
  ControlOutput output;
  output.decision = safety::Gate::decide(parameters.limits, inputs, state.gate);

  // 3. Report.
  if (output.decision.changed) {
    state.t_evidence = std::min(
        now, evidence(output.decision.cause, now, parameters.limits, inputs, state, events));
  }
  output.decision.reasons.insert(parameters.advisories.with(safety::Severity::advisory));
  output.prediction = inputs.prediction;
  // The same number either way: a rotation into robot axes keeps it.
  output.sigma_target_mm = output.decision.approved
                               ? safety::sigma_max_mm(output.decision.approved->covariance())
                               : safety::judged_sigma_mm(inputs);
  output.t_evidence = state.t_evidence;
  output.frame = state.newest_frame;
  output.t_exposure = state.tracking.t_exposure;
  output.t_frame_received = state.t_newest_frame_received;
  return output;
}

}  // namespace holdfast::rt
