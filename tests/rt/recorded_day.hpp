// SPDX-License-Identifier: Apache-2.0
// A day of the control loop in virtual time, for recordings: every kind of input and mode, each
// cycle as the control cycle would put it on a tape.
#pragma once

#include <cmath>
#include <cstdint>

#include "rt/cycle_tape.hpp"
#include "rt/recording.hpp"
#include "tests/rt/virtual_inputs.hpp"

namespace holdfast::rt::testing {

inline ControlParameters recorded_parameters() {
  ControlParameters parameters = healthy_parameters();
  parameters.optics_are_fixed = false;
  return parameters;
}

inline RecordedSession day_session() {
  RecordedSession session;
  session.version = "0.0.test";
  session.run = 1'900'000'000'123'456'789;
  session.utc_minus_monotonic_ns = 1'899'999'000'000'000'000;
  session.loop_period = milliseconds(1);
  session.registration_checksum = "sha256:00";
  session.ct = "1.2.3";
  session.zoom = 1.3;
  session.focus_mm = 200;
  session.parameters = recorded_parameters();
  return session;
}

/// Start, permission, a late frame, lost and degraded estimates, a jump that latches a stop, its
/// acknowledgement, numbers that are none; once in `kDay` cycles.
class RecordedDay {
 public:
  static constexpr std::uint64_t kDay = 10'000;
  /// Without faults: armed at 0.6 s, permitted from then on.
  explicit RecordedDay(bool has_faults = true) : has_faults_(has_faults) {}

  /// Runs the next cycle; `after` gets (info, now, readings, output, state after it).
  template <typename After>
  void cycle(After after) {
    now_ += milliseconds(1);
    const auto i = static_cast<int>(has_faults_ || index_ < 1000 ? index_ % kDay : 1000);
    inputs_.has_frames = i < 3000 || i > 3060;
    inputs_.registration.zoom = i < 9500 || i > 9600 ? kZoom : 2 * kZoom;
    Readings readings = inputs_.at(now_);
    if (readings.estimate) spoil(i, readings.estimate->motion);
    readings.operator_command = command_at(i);
    readings.optics = look_at(i);
    readings.loop.wake_lateness = std::chrono::nanoseconds(1000 + 37 * (i % 11));
    CycleInfo info;
    info.index = index_++;
    info.t_scheduled = now_ - readings.loop.wake_lateness;
    info.t_woken = now_;
    info.lateness = readings.loop.wake_lateness;
    const ControlOutput output = control_step(now_, parameters_, readings, state_);
    is_permitted_ = output.decision.approved.has_value();
    after(info, now_, readings, output, state_);
  }
  void record(CycleTape& tape) {
    cycle([&tape](const auto&... all) { tape.record(all...); });
  }
  [[nodiscard]] bool is_permitted() const { return is_permitted_; }
  [[nodiscard]] std::uint64_t cycles() const { return index_; }

 private:
  static void spoil(int i, perception::MotionEstimate& motion) {
    if (i > 4000 && i < 4050) motion.status = perception::TrackingStatus::lost;
    if (i > 5000 && i < 5050) motion.status = perception::TrackingStatus::degraded;
    if (i > 6000 && i < 6050) motion.T_camera_site.translation().x() += 3;
    if (i > 9000 && i < 9050) motion.covariance.setConstant(std::nan(""));
  }
  /// The microscope as its reader hands it over; a short silence of its node.
  [[nodiscard]] safety::OpticsInput look_at(int i) const {
    safety::OpticsInput look;
    look.has_report = true;
    look.t_report = now_;
    look.is_known = i < 8500 || i > 8550;
    if (!look.is_known) look.faults.insert(safety::Reason::microscope_missing);
    look.zoom = kZoom;
    look.focus_mm = 200;
    return look;
  }
  [[nodiscard]] safety::OperatorInput command_at(int i) const {
    const std::uint32_t stop_id = state_.gate.stop_id;
    if (i == 600 || i == 8000) return {safety::Command::arm, 0};
    if (i == 7000) return {safety::Command::acknowledge, stop_id};
    if (i == 7400) return {safety::Command::confirm, stop_id};
    return {};
  }

  bool has_faults_;
  static constexpr double kZoom = 1.25;
  ControlParameters parameters_ = recorded_parameters();
  ControlState state_;
  VirtualInputs inputs_;
  safety::Timestamp now_ = kStart;
  std::uint64_t index_ = 0;
  bool is_permitted_ = false;
};

}  // namespace holdfast::rt::testing
