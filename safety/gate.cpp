// SPDX-License-Identifier: Apache-2.0
#include "safety/gate.hpp"

#include "safety/acknowledgement.hpp"
#include "safety/composition.hpp"
#include "safety/mode_table.hpp"
#include "safety/monitors.hpp"
#include "safety/numbers.hpp"

namespace holdfast::safety {
namespace {

/// Products of transforms that each pass is_rigid.
constexpr double kComposedTolerance = 10 * kRigidTolerance;
/// Rounding when a covariance is turned into robot axes.
constexpr double kSigmaRounding = 1 + 1e-9;

bool has_fault(ReasonSet reasons) noexcept {
  return !reasons.with(Severity::stop).empty() || !reasons.with(Severity::hold).empty();
}

/// A registration that comes, goes or changes takes the keyframe's verification with it.
void follow_registration(const Inputs& inputs, GateState& state) noexcept {
  const RegistrationInput& registration = inputs.registration;
  const bool is_same =
      registration.is_loaded && state.has_registration && registration.id == state.registration_id;
  if (is_same) return;
  state.has_registration = registration.is_loaded;
  state.registration_id = registration.is_loaded ? registration.id : 0;
  state.t_registration_seen = inputs.now;
  state.is_keyframe_verified = false;
}

/// While the optics are in doubt the image says nothing of the registration: what was verified
/// before is void, and only an image exposed after the doubt verifies anew. In permitted and hold
/// the stop or the recovery that follows sees to that.
void follow_optics(ReasonSet reasons, Timestamp now, GateState& state) noexcept {
  if ((reasons.bits() & kOpticsReasons.bits()) == 0) return;
  state.t_optics_doubted = now;
  if (state.mode == Mode::ready) state.is_keyframe_verified = false;
}

/// A camera fault is an event of one cycle; its effect lasts until a good frame has come after it.
void follow_camera(const CameraInput& camera, GateState& state) noexcept {
  if (!camera.faults.empty() || !camera.is_connected) {
    state.is_awaiting_good_frame = true;
    state.t_frame_at_fault = camera.t_last_frame_received;
  } else if (camera.t_last_frame_received > state.t_frame_at_fault) {
    state.is_awaiting_good_frame = false;
  }
}

/// Keeps the hold's cause and since when all is well.
void follow_hold(ReasonSet reasons, Timestamp now, GateState& state) noexcept {
  const ReasonSet holds = reasons.with(Severity::hold);
  if (!holds.empty()) state.hold_cause = holds.primary();
  if (!holds.empty() || state.is_awaiting_good_frame) state.t_well_since = now;
}

ConditionSet conditions(const Limits& limits, const Inputs& inputs, ReasonSet reasons,
                        GateState& state) noexcept {
  const Command command = inputs.operator_command.command;
  const bool is_well = !has_fault(reasons) && !state.is_awaiting_good_frame;
  ConditionSet set;
  set.set(Condition::latching_fault, !latching_reasons(state.mode, reasons).empty());
  set.set(Condition::inputs_arrived, inputs.camera.has_frame);
  set.set(Condition::verified, inputs.tracking.is_new && !state.is_awaiting_good_frame &&
                                   passes_drift_check(inputs, reasons, t_image_counts(state)));
  set.set(Condition::verification_withdrawn, !state.is_keyframe_verified);
  set.set(Condition::armed, command == Command::arm && is_well &&
                                inputs.tracking.t_exposure > state.t_optics_doubted);
  set.set(Condition::disarmed, command == Command::disarm);
  set.set(Condition::hold_reason, !reasons.with(Severity::hold).empty());
  set.set(Condition::recovered,
          is_well && elapsed(state.t_well_since, inputs.now) >= limits.hold_recovery);
  set.set(Condition::released, state.mode == Mode::stop_latched &&
                                   completes_acknowledgement(limits, inputs, reasons, state));
  return set;
}

void latch_stop(Reason cause, Timestamp now, GateState& state) noexcept {
  state.mode = Mode::stop_latched;
  state.t_mode_entered = now;
  state.stop_cause = cause;
  state.stop_id = state.stop_id + 1 == 0 ? 1 : state.stop_id + 1;  // 0 names no stop
  state.is_acknowledged = false;
}

void enter(Mode mode, ReasonSet reasons, Timestamp now, GateState& state) noexcept {
  if (mode == state.mode) return;
  if (mode == Mode::stop_latched) {
    latch_stop(latching_reasons(state.mode, reasons).primary(), now, state);
    return;
  }
  if (mode == Mode::hold) state.t_hold_entered = now;
  const bool is_verified_now =
      mode == Mode::ready && (state.mode == Mode::unregistered || state.mode == Mode::stop_latched);
  if (is_verified_now) state.is_keyframe_verified = true;
  state.mode = mode;
  state.t_mode_entered = now;
}

/// What else stands between this mode and permission.
ReasonSet readiness_reasons(const GateState& state) noexcept {
  ReasonSet reasons;
  if (state.mode == Mode::init) reasons.insert(Reason::initialising);
  if (state.mode == Mode::ready) reasons.insert(Reason::not_armed);
  if (state.mode == Mode::stop_latched) reasons.insert(Reason::awaiting_acknowledgement);
  if (!state.has_registration) {
    reasons.insert(Reason::not_registered);
  } else if (!state.is_keyframe_verified) {
    reasons.insert(Reason::keyframe_unverified);
  }
  return reasons;
}

Reason cause_of(ReasonSet reasons, const GateState& state) noexcept {
  if (state.mode == Mode::stop_latched) return state.stop_cause;
  if (state.mode == Mode::hold && !has_fault(reasons)) return state.hold_cause;
  return reasons.primary();
}

/// What must be true of every decision, whatever led to it.
bool is_consistent(const Limits& limits, const Inputs& inputs, const Decision& decision,
                   const GateState& state) noexcept {
  const std::optional<ApprovedPose>& approved = decision.approved;
  if (decision.mode == Mode::permitted) {
    return approved.has_value() && decision.reasons.empty() && decision.cause == Reason::none &&
           state.is_keyframe_verified && inputs.registration.is_loaded &&
           approved->registration_id() == state.registration_id &&
           approved->t_pose() == inputs.now + limits.pose_lead &&
           approved->validity() > Duration::zero() &&
           is_rigid(approved->T_robot_ct(), kComposedTolerance) &&
           is_covariance(approved->covariance()) &&
           !exceeds(sigma_max_mm(approved->covariance()),
                    limits.sigma_target_max_mm * kSigmaRounding);
  }
  if (approved.has_value() || decision.cause == Reason::none) return false;
  if (decision.mode != Mode::stop_latched) return decision.mode < Mode::stop_latched;
  return severity(state.stop_cause) == Severity::stop && state.stop_id != 0;
}

}  // namespace

Decision Gate::decide(const Limits& limits, const Inputs& inputs, GateState& state) noexcept {
  const Mode previous_mode = state.mode;
  const Reason previous_cause = state.cause;

  // 1. Judge the inputs, and what of the past still counts.
  ReasonSet reasons = observed_reasons(limits, inputs, state);
  follow_registration(inputs, state);
  follow_optics(reasons, inputs.now, state);
  follow_camera(inputs.camera, state);
  follow_hold(reasons, inputs.now, state);
  const bool is_overdue =
      state.mode == Mode::hold && elapsed(state.t_hold_entered, inputs.now) > limits.hold_max;
  if (is_overdue) reasons.insert(Reason::hold_timeout);

  // 2. One transition.
  enter(next_mode(state.mode, conditions(limits, inputs, reasons, state)), reasons, inputs.now,
        state);
  reasons.insert(readiness_reasons(state));

  Decision decision;
  decision.mode = state.mode;
  decision.reasons = reasons;
  decision.cause = cause_of(reasons, state);

  // 3. The pose, in permitted only.
  if (state.mode == Mode::permitted && inputs.prediction) {
    ApprovedPose pose;
    const PredictedPose& prediction = *inputs.prediction;
    pose.T_robot_ct_ =
        inputs.T_robot_camera * prediction.T_camera_site * inputs.registration.T_site_ct;
    pose.covariance_ = rotated(inputs.T_robot_camera.linear(), covariance_at_target(inputs));
    pose.t_pose_ = inputs.now + limits.pose_lead;
    pose.validity_ = limits.pose_validity;
    pose.registration_id_ = inputs.registration.id;
    decision.approved = pose;
  }

  // 4. Trust nothing, ourselves included.
  if (!is_consistent(limits, inputs, decision, state)) {
    latch_stop(Reason::internal_fault, inputs.now, state);
    decision.mode = state.mode;
    decision.cause = Reason::internal_fault;
    decision.reasons.insert(Reason::internal_fault);
    decision.reasons.insert(Reason::awaiting_acknowledgement);
    decision.approved.reset();
  }

  decision.stop_id = state.stop_id;
  decision.changed =
      !state.has_cycle || decision.mode != previous_mode || decision.cause != previous_cause;
  state.cause = decision.cause;
  state.t_last_cycle = inputs.now;
  state.has_cycle = true;
  return decision;
}

}  // namespace holdfast::safety
