// SPDX-License-Identifier: Apache-2.0
#include "tests/fault/world.hpp"

#include <algorithm>
#include <cmath>

#include "tests/rt/virtual_inputs.hpp"

namespace holdfast::fault {
namespace {

using bridge::dds::Clocks;
using bridge::dds::protect;
using safety::Mode;
using safety::Reason;

constexpr nanoseconds kStep = milliseconds(1);
constexpr nanoseconds kUtcOffset = std::chrono::seconds(1'700'000'000);

client::Parameters client_parameters(const WorldOptions& options) {
  client::Parameters parameters;
  parameters.guard = options.has_guard ? client::Guard::required : client::Guard::absent;
  return parameters;
}

safety::ReceiverParameters robot_receiver() {
  safety::ReceiverParameters parameters;
  parameters.max_validity = milliseconds(100);
  return parameters;
}

}  // namespace

const char* name(Bug bug) noexcept {
  constexpr const char* kNames[] = {"none",
                                    "publisher_repeats_last_pose",
                                    "publisher_claims_permission",
                                    "robot_keeps_last_pose",
                                    "frames_stamped_on_arrival",
                                    "faults_not_reported",
                                    "silence_reported_as_frames",
                                    "estimate_repeated_as_new",
                                    "lost_reported_as_tracking",
                                    "covariance_not_filled_honestly",
                                    "registration_kept_after_change",
                                    "drift_not_measured",
                                    "robot_clock_not_checked",
                                    "optics_restamped"};
  return kNames[static_cast<std::size_t>(bug)];
}

World::World(std::uint64_t seed, const WorldOptions& options)
    : options_(options),
      random_(seed),
      registration_(rt::testing::VirtualInputs().registration),
      t_next_exposure_(now_ + milliseconds(3)),
      watch_({}, now_),
      parameters_(rt::testing::healthy_parameters()),
      robot_receiver_(safety::DataId::robot_status, robot_receiver()),
      guard_(guard::GuardLimits{}, Eigen::Isometry3d::Identity()),
      client_(client_parameters(options)) {
  readings_.registration = registration_;
  parameters_.optics_are_fixed = false;
  if (options.frame_lateness) parameters_.limits.frame_lateness = *options.frame_lateness;
  if (options_.is_lively) draw_motion();
}

bool World::happens(double probability) {
  return probability > 0 && uniform(0, 1) < probability;
}

Clocks World::clocks() const {
  return {now_, now_ + kUtcOffset};
}

/// Arms whenever it may, acknowledges every stop: the least careful operator there is.
void World::run_operator() {
  readings_.operator_command = {};
  if (disturbance.is_operator_stop) readings_.operator_command.command = safety::Command::stop;
  if (disturbance.is_operator_corrupt) is_input_corrupt_ = true;
  if (disturbance.is_operator_stop || now_ - t_operator_ < milliseconds(50)) return;
  if (state_.gate.mode == Mode::ready) {
    readings_.operator_command.command = safety::Command::arm;
    t_operator_ = now_;
  } else if (state_.gate.mode == Mode::stop_latched) {
    readings_.operator_command = {
        has_acknowledged_ ? safety::Command::confirm : safety::Command::acknowledge,
        state_.gate.stop_id};
    t_operator_ = now_ + (has_acknowledged_ ? milliseconds(0) : milliseconds(200));
    has_acknowledged_ = !has_acknowledged_;
  }
}

void World::run_loop() {
  const Disturbance& d = disturbance;
  if (d.is_daemon_dead || d.is_loop_stalled || is_daemon_suspended_) return;
  run_operator();
  if (has_robot_input_) readings_.robot_status = robot_input_;
  has_robot_input_ = false;
  readings_.loop.message_corrupt = is_input_corrupt_;
  is_input_corrupt_ = false;
  const nanoseconds lost = t_last_cycle_ == nanoseconds(0) ? kStep : now_ - t_last_cycle_;
  t_last_cycle_ = now_;
  readings_.loop.wake_lateness = d.wake_lateness + lost - kStep + unrest(milliseconds(1));
  readings_.loop.clock_divergence = d.has_clock_step ? milliseconds(5) : nanoseconds(0);
  readings_.loop.second_publisher = d.has_second_publisher;
  if (d.has_overflow) readings_.loop.internal_fault = true;
  using safety::Command;
  const Command command = readings_.operator_command.command;
  if (command == Command::arm || command == Command::acknowledge) is_recovery_wanted_ = true;
  readings_.registration = registration_;
  if (options_.bug != Bug::registration_kept_after_change) {
    if (d.is_registration_withdrawn) readings_.registration.is_loaded = false;
    if (d.is_registration_replaced) ++readings_.registration.id;
  }
  const rt::ControlOutput output = rt::control_step(now_, parameters_, readings_, state_);
  readings_ = {};
  is_withheld_ = !output.decision.approved.has_value();
  if (output.decision.changed) t_changed_ = now_;
  if (!d.is_publisher_dead) publish(output);
}

void World::run_guard() {
  if (!options_.has_guard || disturbance.is_guard_dead || is_guard_suspended_) return;
  const guard::GuardAnswer& answer = guard_.decide(now_);
  const bool is_changed = answer.cause != guard_cause_;
  guard_cause_ = answer.cause;
  if (!is_changed && now_ - t_guard_sent_ < milliseconds(2)) return;
  t_guard_sent_ = now_;
  msg::GuardPermission m{};
  m.is_permitted = answer.is_permitted;
  m.cause = static_cast<std::uint8_t>(answer.cause);
  m.daemon_source = answer.daemon_source;
  m.t_changed_ns = answer.t_changed.count();
  protect(m, kGuard, ++guard_counter_, milliseconds(10), clocks());
  if (!disturbance.is_cut_to_robot) client_.take(m, clocks());
}

Observation World::run_robot() {
  const client::Permission permission = client_.decide(now_);
  std::optional<client::Pose> pose = permission.pose;
  if (pose) kept_pose_ = pose;
  if (options_.bug == Bug::robot_keeps_last_pose) pose = kept_pose_;
  if (options_.bug == Bug::robot_clock_not_checked && !pose && kept_pose_ &&
      now_.count() - kept_pose_->t_pose_ns < 1'000'000'000 &&
      (permission.refusal == client::Refusal::pose_silent ||
       permission.refusal == client::Refusal::stop_silent ||
       permission.refusal == client::Refusal::guard_silent))
    pose = kept_pose_;
  if (disturbance.has_robot_fault) pose.reset();
  report_robot(pose.has_value());
  Observation seen;
  seen.is_permitted = pose.has_value();
  seen.is_withheld = is_withheld_;
  seen.mode = state_.gate.mode;
  seen.cause = state_.gate.cause;
  seen.refusal = permission.refusal;
  seen.guard_cause = guard_cause_;
  if (!pose) return seen;
  Eigen::Isometry3d T_robot_ct = Eigen::Isometry3d::Identity();
  const auto& q = pose->rotation_xyzw;
  T_robot_ct.linear() = Eigen::Quaterniond(q[3], q[0], q[1], q[2]).toRotationMatrix();
  T_robot_ct.translation() =
      Eigen::Vector3d(pose->translation_mm[0], pose->translation_mm[1], pose->translation_mm[2]);
  Eigen::Isometry3d T_true = T_robot_camera_ * T_camera_site_true() * registration_.T_site_ct;
  // With another patient's registration every pose is wrong.
  if (disturbance.is_registration_replaced || disturbance.is_registration_withdrawn)
    T_true.translation().y() += 5;
  seen.error_mm = (T_robot_ct * p_target_ct_mm_ - T_true * p_target_ct_mm_).norm();
  return seen;
}

void World::report_robot(bool is_permitted) {
  const bool is_change = is_permitted != was_permitted_;
  was_permitted_ = is_permitted;
  if (disturbance.is_robot_silent || (!is_change && now_ - t_robot_report_ < milliseconds(10)))
    return;
  t_robot_report_ = now_;
  msg::RobotStatus status{};
  status.is_enabled = is_permitted;
  status.has_fault = disturbance.has_robot_fault;
  protect(status, kRobot, ++robot_counter_, milliseconds(100), clocks());
  tell_guard(status);
  if (disturbance.is_cut_from_robot || disturbance.is_daemon_dead) return;
  if (is_daemon_suspended_)
    daemon_inbox_.push_back(status);
  else
    take_robot_status(status);
}

void World::take_robot_status(const msg::RobotStatus& status) {
  if (bridge::dds::check(status, robot_receiver_, clocks()) == safety::Verdict::accepted) {
    robot_input_ = bridge::dds::to_input(status, now_);
    has_robot_input_ = true;
  } else {
    is_input_corrupt_ = true;
  }
}

Observation World::step() {
  now_ += kStep;
  ++steps_;
  run_scheduler();
  move_site();
  run_camera();
  if (!is_daemon_suspended_) deliver_estimates();
  run_microscope();
  run_loop();
  run_wire();
  run_guard();
  return run_robot();
}

}  // namespace holdfast::fault
