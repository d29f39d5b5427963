// SPDX-License-Identifier: Apache-2.0
#include "rt/recording.hpp"

namespace holdfast::rt {

RecordedInput recorded_input(const TapedCycle& cycle) {
  const auto& [info, t_decided, t_done, readings, output] = cycle;
  const auto& [index, t_scheduled, t_woken, lateness, missed] = info;
  (void)output;
  (void)lateness;  // is readings.loop.wake_lateness
  return {index, t_scheduled, t_woken, t_decided, t_done, missed, readings};
}

RecordedDecision recorded_decision(std::uint64_t cycle, const ControlOutput& output) {
  const auto& [decision, prediction, sigma, t_evidence, frame, t_exposure, t_received] = output;
  const auto& [mode, cause, reasons, changed, stop_id, approved] = decision;
  RecordedDecision recorded;
  recorded.cycle = cycle;
  recorded.mode = mode;
  recorded.cause = cause;
  recorded.reasons = reasons;
  recorded.changed = changed;
  recorded.stop_id = stop_id;
  if (approved)
    recorded.approved =
        RecordedPose{approved->T_robot_ct(), approved->covariance(), approved->t_pose(),
                     approved->validity(), approved->registration_id()};
  recorded.prediction = prediction;
  recorded.sigma_target_mm = sigma;
  recorded.t_evidence = t_evidence;
  recorded.frame = frame;
  recorded.t_exposure = t_exposure;
  recorded.t_frame_received = t_received;
  return recorded;
}

}  // namespace holdfast::rt
