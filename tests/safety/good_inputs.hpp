// SPDX-License-Identifier: Apache-2.0
// Inputs with which nothing is wrong, and a gate driven with them, for tests that then make one
// thing wrong.
#pragma once

#include <functional>

#include "safety/gate.hpp"

namespace holdfast::safety::test {

inline constexpr std::uint64_t kRegistrationId = 0xA1B2'C3D4;

/// Everything in order at `now`: an image exposed 10 ms ago, received and tracked just now.
inline Inputs good_inputs(Timestamp now) {
  using std::chrono::milliseconds;
  Inputs inputs;
  inputs.now = now;
  inputs.camera = {.is_connected = true,
                   .has_frame = true,
                   .t_last_frame_received = now - milliseconds(2),
                   .faults = {}};
  inputs.tracking = {.has_estimate = true,
                     .is_new = true,
                     .is_lost = false,
                     .is_degraded = false,
                     .registration_id = kRegistrationId,
                     .t_exposure = now - milliseconds(10),
                     .inliers = 120,
                     .inlier_spread = 0.5,
                     .has_drift = true,
                     .drift_mm = 0.02,
                     .contradicts_filter = false,
                     .scale = 1};
  PredictedPose prediction;
  prediction.T_camera_site.translation() = Eigen::Vector3d(0.5, -0.3, 0.1);
  prediction.covariance.diagonal() << 1e-4, 1e-4, 4e-4, 1e-8, 1e-8, 1e-8;
  prediction.speed_mm_per_s = 2;
  inputs.prediction = prediction;
  inputs.registration.is_loaded = true;
  inputs.registration.id = kRegistrationId;
  inputs.registration.T_site_ct.translation() = Eigen::Vector3d(10, -20, 180);
  inputs.registration.covariance.diagonal() << 1e-3, 1e-3, 2e-3, 1e-7, 1e-7, 1e-7;
  inputs.registration.p_target_site_mm = Eigen::Vector3d(1, 2, 200);
  inputs.registration.zoom = 1.25;
  inputs.registration.focus_mm = 200;
  inputs.optics.has_report = true;
  inputs.optics.t_report = now - milliseconds(1);
  inputs.optics.is_known = true;
  inputs.optics.zoom = 1.25;
  inputs.optics.focus_mm = 200;
  inputs.robot = {.has_status = true, .t_last_status = now - milliseconds(10), .has_fault = false};
  return inputs;
}

/// A gate with its state and clock, fed with good inputs unless told otherwise.
struct GateDriver {
  using Change = std::function<void(Inputs&)>;

  Limits limits;
  GateState state;
  Timestamp now = std::chrono::seconds(100);

  /// One cycle `after` the previous one.
  Decision step(const Change& change = {}, Duration after = std::chrono::milliseconds(1)) {
    now += after;
    Inputs inputs = good_inputs(now);
    if (change) change(inputs);
    return Gate::decide(limits, inputs, state);
  }

  Decision command(Command command, std::uint32_t stop_id = 0) {
    return step([=](Inputs& inputs) { inputs.operator_command = {command, stop_id}; });
  }

  /// Good cycles of 1 ms for `time`; returns the last decision.
  Decision run(Duration time, const Change& change = {}) {
    Decision decision;
    for (const Timestamp end = now + time; now < end;) decision = step(change);
    return decision;
  }

  /// From the start, by good cycles and commands alone.
  void to_ready() { run(std::chrono::milliseconds(20)); }
  Decision to_permitted() {
    to_ready();
    return command(Command::arm);
  }
};

}  // namespace holdfast::safety::test
