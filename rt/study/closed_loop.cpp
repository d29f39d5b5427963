// SPDX-License-Identifier: Apache-2.0
#include "rt/study/closed_loop.hpp"

#include <cmath>
#include <set>

#include <fmt/format.h>

#include "rt/control_step.hpp"
#include "safety/reason.hpp"

namespace holdfast::rt {
namespace {

using perception::MotionEstimate;
using safety::Timestamp;
using std::chrono::milliseconds;

constexpr Timestamp kStart = std::chrono::seconds(1000);  // of the virtual clock
constexpr milliseconds kCycle{1};
constexpr std::uint64_t kRegistration = 1;

class Loop {
 public:
  Loop(std::span<const MotionEstimate> estimates, const ClosedLoopSettings& settings)
      : estimates_(estimates), settings_(settings), t_first_(estimates.front().t_exposure) {
    parameters_.limits.frame_period = safety::Duration{std::llround(1e9 / settings.rate_hz)};
    parameters_.limits.pose_lead = settings.pose_lead;
    parameters_.optics_are_fixed = true;
    registration_.is_loaded = true;
    registration_.id = kRegistration;
    registration_.p_target_site_mm = settings.p_target_site_mm;
    constexpr double kVarianceMm2 = 1e-10, kVarianceRad2 = 1e-16;  // exact
    registration_.covariance.diagonal().head<3>().setConstant(kVarianceMm2);
    registration_.covariance.diagonal().tail<3>().setConstant(kVarianceRad2);
  }

  ClosedLoopRun run() {
    run_.commands = "t_ns,is_permitted,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw\n";
    const Timestamp t_end = exposure(estimates_.size() - 1);
    for (Timestamp now = kStart; now <= t_end; now += kCycle) cycle(now);
    for (const safety::Reason cause : causes_)
      run_.stop_causes +=
          fmt::format("{}{}", run_.stop_causes.empty() ? "" : " ", safety::name(cause));
    return std::move(run_);
  }

 private:
  [[nodiscard]] Timestamp exposure(std::size_t frame) const {
    return kStart + (estimates_[frame].t_exposure - t_first_);
  }

  [[nodiscard]] Readings readings(Timestamp now) {
    Readings readings;
    readings.registration = registration_;
    readings.robot_status = safety::RobotInput{true, now, false};
    for (; arrived_ < estimates_.size() && exposure(arrived_) + settings_.arrival <= now;
         ++arrived_) {
      FrameArrival& arrival = readings.arrivals[readings.arrival_count++];
      arrival.frame = arrived_ + 1;
      arrival.t_exposure = exposure(arrived_);
      arrival.t_received = arrival.t_exposure + settings_.arrival;
    }
    for (; tracked_ < estimates_.size() && exposure(tracked_) + settings_.estimate <= now;
         ++tracked_) {
      StampedEstimate& estimate = readings.estimate.emplace();
      estimate.motion = estimates_[tracked_];
      estimate.motion.t_exposure = exposure(tracked_);
      estimate.registration_id = kRegistration;
      estimate.frame = tracked_ + 1;
      estimate.t_frame_received = estimate.motion.t_exposure + settings_.arrival;
      estimate.t_published = estimate.motion.t_exposure + settings_.estimate;
    }
    readings.operator_command = operator_command(now);
    return readings;
  }

  /// Arms what is ready, ends what is latched, as fast as the gate lets anybody.
  [[nodiscard]] safety::OperatorInput operator_command(Timestamp now) {
    constexpr milliseconds kPause{50};
    if (now < t_next_command_) return {};
    const safety::GateState& gate = state_.gate;
    if (gate.mode == safety::Mode::ready) {
      t_next_command_ = now + kPause;
      return {safety::Command::arm, 0};
    }
    if (gate.mode != safety::Mode::stop_latched) return {};
    const bool is_second = has_acknowledged_;
    has_acknowledged_ = !has_acknowledged_;
    t_next_command_ = now + kPause + (is_second ? milliseconds(0) : parameters_.limits.confirm_min);
    return {is_second ? safety::Command::confirm : safety::Command::acknowledge, gate.stop_id};
  }

  void cycle(Timestamp now) {
    const ControlOutput output = control_step(now, parameters_, readings(now), state_);
    const safety::Decision& decision = output.decision;
    if (decision.mode == safety::Mode::stop_latched && decision.stop_id != stop_id_) {
      stop_id_ = decision.stop_id;
      has_acknowledged_ = false;
      ++run_.stops;
      causes_.insert(decision.cause);
    }
    const auto t_ns = (t_first_ + (now - kStart)).count();
    if (!decision.approved) {
      run_.commands += fmt::format("{},0,,,,,,,\n", t_ns);
      return;
    }
    const Eigen::Isometry3d& T = decision.approved->T_robot_ct();
    const Eigen::Quaterniond q(T.linear());
    run_.commands += fmt::format("{},1,{:.7f},{:.7f},{:.7f},{:.10f},{:.10f},{:.10f},{:.10f}\n",
                                 t_ns, T.translation().x(), T.translation().y(),
                                 T.translation().z(), q.x(), q.y(), q.z(), q.w());
  }

  const std::span<const MotionEstimate> estimates_;
  const ClosedLoopSettings& settings_;
  const std::chrono::nanoseconds t_first_;
  ControlParameters parameters_;
  safety::RegistrationInput registration_;
  ControlState state_;
  std::size_t arrived_ = 0, tracked_ = 0;
  Timestamp t_next_command_{};
  bool has_acknowledged_ = false;
  std::uint32_t stop_id_ = 0;
  std::set<safety::Reason> causes_;
  ClosedLoopRun run_;
};

}  // namespace

ClosedLoopRun run_closed_loop(std::span<const MotionEstimate> estimates,
                              const ClosedLoopSettings& settings) {
  if (estimates.empty()) return {};
  return Loop(estimates, settings).run();
}

}  // namespace holdfast::rt
