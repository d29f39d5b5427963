// SPDX-License-Identifier: Apache-2.0
// One cycle of the loop as the daemon runs it, threads left out: queue and mailbox in, control
// step, latch and mailbox out. For the guards and the benchmark.
#pragma once

#include "rt/control_step.hpp"
#include "rt/core/clock.hpp"
#include "rt/core/event_queue.hpp"
#include "rt/core/latency_histogram.hpp"
#include "rt/core/mailbox.hpp"
#include "rt/core/stop_latch.hpp"
#include "tests/rt/virtual_inputs.hpp"

namespace holdfast::rt::testing {

class RtPath {
 public:
  /// What camera, tracker, robot and operator threads would do; not real-time.
  void deliver(const Readings& readings) {
    for (std::size_t i = 0; i < readings.arrival_count; ++i) {
      is_overflown_ |= !arrivals_.try_push(readings.arrivals[i]);
    }
    if (readings.estimate) estimates_.publish(*readings.estimate);
    if (readings.robot_status) robot_.publish(*readings.robot_status);
    registration_ = readings.registration;
    command_ = readings.operator_command;
  }

  /// The real-time part.
  void cycle(safety::Timestamp now) noexcept {
    const auto t_begin = monotonic_now();
    Readings readings;
    while (readings.arrival_count < Readings::kMaxArrivals &&
           arrivals_.try_pop(readings.arrivals[readings.arrival_count])) {
      ++readings.arrival_count;
    }
    if (estimates_.try_take(estimate_)) readings.estimate = estimate_;
    safety::RobotInput robot;
    if (robot_.try_take(robot)) readings.robot_status = robot;
    readings.registration = registration_;
    readings.operator_command = command_;
    readings.loop.internal_fault = is_overflown_;
    const ControlOutput output = control_step(now, parameters, readings, state);
    mode = output.decision.mode;
    if (!output.decision.approved) latch.raise(output.decision.reasons.bits(), ++cycles_);
    outputs.publish(output);
    step_time.record(monotonic_now() - t_begin);
  }

  ControlParameters parameters = healthy_parameters();
  ControlState state;
  StopLatch latch;
  Mailbox<ControlOutput> outputs;
  LatencyHistogram step_time;
  safety::Mode mode{};

 private:
  EventQueue<FrameArrival, 16> arrivals_;
  Mailbox<StampedEstimate> estimates_;
  Mailbox<safety::RobotInput> robot_;
  StampedEstimate estimate_;
  safety::RegistrationInput registration_;
  safety::OperatorInput command_;
  bool is_overflown_ = false;
  std::uint64_t cycles_ = 0;
};

/// Drives 10,000 cycles at 1 kHz through every kind of day: start, permission, a late frame, a lost
/// and a degraded estimate, and at the end a jump and a number that is none. `cycle` runs one
/// cycle.
template <typename Cycle>
void run_every_kind_of_day(RtPath& path, Cycle cycle) {
  VirtualInputs inputs;
  safety::Timestamp now = kStart;
  for (int i = 0; i < 10'000; ++i) {
    now += milliseconds(1);
    inputs.has_frames = i < 3000 || i > 3060;
    Readings readings = inputs.at(now);
    if (i == 600) readings.operator_command.command = safety::Command::arm;
    if (readings.estimate) {
      perception::MotionEstimate& motion = readings.estimate->motion;
      if (i > 4000 && i < 4050) motion.status = perception::TrackingStatus::lost;
      if (i > 5000 && i < 5050) motion.status = perception::TrackingStatus::degraded;
      if (i > 8000 && i < 8050) motion.T_camera_site.translation().x() += 3;
      if (i > 9000) motion.covariance.setConstant(std::nan(""));
    }
    path.deliver(readings);
    cycle(path, now);
  }
}

}  // namespace holdfast::rt::testing
