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
constexpr nanoseconds kFramePeriod = microseconds(33'333);
constexpr nanoseconds kUtcOffset = std::chrono::seconds(1'700'000'000);
constexpr std::uint32_t kDaemon = 7, kGuard = 8, kRobot = 9, kStranger = 66;

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
                                    "robot_clock_not_checked"};
  return kNames[static_cast<std::size_t>(bug)];
}

World::World(std::uint64_t seed, const WorldOptions& options)
    : options_(options),
      random_(seed),
      registration_(rt::testing::VirtualInputs().registration),
      t_next_exposure_(now_ + milliseconds(3)),
      parameters_(rt::testing::healthy_parameters()),
      robot_receiver_(safety::DataId::robot_status, robot_receiver()),
      guard_(guard::GuardLimits{}, Eigen::Isometry3d::Identity()),
      client_(client_parameters(options)) {
  readings_.registration = registration_;
}

bool World::happens(double probability) {
  return probability > 0 && uniform(0, 1) < probability;
}

Clocks World::clocks() const {
  return {now_, now_ + kUtcOffset};
}

/// 2 mm/s to and fro, and what the disturbance adds.
Eigen::Isometry3d World::T_camera_site_true() const {
  const double s = std::chrono::duration<double>(now_).count();
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.translation().x() = 2 * std::sin(s) + extra_x_mm_;
  const Eigen::AngleAxisd turn(0.01 * std::sin(0.7 * s) + extra_turn_rad_,
                               Eigen::Vector3d::UnitZ());
  T.linear() = turn.toRotationMatrix();
  return T;
}

void World::move_site() {
  extra_x_mm_ += disturbance.site_speed_mm_per_s * 1e-3;
  extra_turn_rad_ += disturbance.site_turn_rad_per_s * 1e-3;
  if (disturbance.site_jump_mm != 0 && !has_jumped_) {
    extra_x_mm_ += disturbance.site_jump_mm;
    has_jumped_ = true;
  }
  estimate_slide_mm_ += disturbance.estimate_rate_mm_per_s * 1e-3;
}

perception::MotionEstimate World::estimate() {
  const Disturbance& d = disturbance;
  perception::MotionEstimate motion = rt::testing::healthy_estimate(now_ + d.exposure_error);
  motion.T_camera_site = T_camera_site_true();
  std::normal_distribution<double> noise(0, 0.003);
  for (int axis = 0; axis < 3; ++axis) motion.T_camera_site.translation()[axis] += noise(random_);
  motion.T_camera_site.translation().y() += d.estimate_offset_mm + estimate_slide_mm_;
  const double wrong_mm = std::abs(d.estimate_offset_mm + estimate_slide_mm_);
  motion.drift_um = 5 + (d.is_drift_seen ? 1e3 * wrong_mm : 0);
  motion.has_drift = !d.has_no_drift;
  if (options_.bug == Bug::drift_not_measured) motion.drift_um = 5;
  if (options_.bug != Bug::covariance_not_filled_honestly)
    motion.covariance *= d.covariance_scale * d.covariance_scale;
  if (d.covariance_scale > 1)
    motion.T_camera_site.translation().y() += 0.01 * d.covariance_scale * noise(random_) / 0.003;
  if (d.is_degraded) motion.status = perception::TrackingStatus::degraded;
  if (d.has_few_inliers) motion.inliers = 8;
  if (d.has_bunched_inliers) motion.inlier_spread = 0.05;
  if (d.has_nan) motion.T_camera_site.translation().z() = std::nan("");
  if (d.has_bad_rotation) motion.T_camera_site.linear() *= 1.01;
  if (d.is_lost) motion.status = perception::TrackingStatus::lost;
  return motion;
}

/// A frame each period; what the disturbance does to it.
void World::run_camera() {
  const Disturbance& d = disturbance;
  if (d.is_camera_disconnected == was_connected_) {  // the event comes once
    was_connected_ = !d.is_camera_disconnected;
    Pending event;
    event.t_arrival = now_;
    event.arrival.t_received = now_;
    event.arrival.is_connected = was_connected_;
    event.arrival.is_frame = false;
    pending_.push_back(event);
  }
  if (now_ < t_next_exposure_) return;
  t_next_exposure_ += kFramePeriod;
  ++frame_;
  const bool is_missing =
      d.is_camera_silent || d.is_camera_disconnected || (d.is_skipping_frames && frame_ % 2 == 0);
  if (is_missing && options_.bug != Bug::silence_reported_as_frames) return;
  Pending p;
  p.t_arrival = now_ + milliseconds(6) + d.frame_delay;
  p.t_estimate = now_ + milliseconds(16) + d.frame_delay + d.tracker_delay;
  p.arrival.frame = frame_;
  p.arrival.t_exposure = now_ + d.exposure_error;
  p.arrival.t_received = p.t_arrival;
  if (options_.bug != Bug::faults_not_reported) {
    p.arrival.faults = d.frame_faults;
    if (d.is_skipping_frames) p.arrival.faults.insert(Reason::frame_gap);
    if (d.is_frozen) p.arrival.faults.insert(Reason::frame_frozen);
  }
  const bool is_tracked = !d.is_tracker_silent && !is_missing &&
                          (d.frame_faults.empty() || options_.bug == Bug::faults_not_reported);
  if (is_tracked) {
    rt::StampedEstimate e;
    e.motion = estimate();
    if (d.is_frozen && newest_estimate_) {
      if (!frozen_) frozen_ = newest_estimate_;
      e.motion.T_camera_site = frozen_->motion.T_camera_site;
    }
    if (!d.is_frozen) frozen_.reset();
    if (options_.bug == Bug::lost_reported_as_tracking && d.is_lost && newest_estimate_) {
      e.motion = newest_estimate_->motion;
      e.motion.t_exposure = now_;
    }
    if (options_.bug == Bug::frames_stamped_on_arrival) e.motion.t_exposure = p.t_estimate;
    e.registration_id = registration_.id + (d.has_other_keyframe ? 1 : 0);
    e.frame = frame_;
    e.t_frame_received = p.t_arrival;
    e.t_published = p.t_estimate;
    p.estimate = e;
  } else if (options_.bug == Bug::estimate_repeated_as_new && newest_estimate_) {
    p.estimate = newest_estimate_;
    p.estimate->motion.t_exposure = now_;
  }
  pending_.push_back(p);
}

void World::deliver_estimates() {
  for (Pending& p : pending_) {
    if (!p.has_arrived && p.t_arrival <= now_) {
      p.has_arrived = true;
      if (readings_.arrival_count < rt::Readings::kMaxArrivals)
        readings_.arrivals[readings_.arrival_count++] = p.arrival;
      else
        readings_.loop.internal_fault = true;
    }
    if (p.estimate && p.t_estimate <= now_ && p.has_arrived) {
      readings_.estimate = newest_estimate_ = p.estimate;
      p.estimate.reset();
    }
  }
  while (!pending_.empty() && pending_.front().has_arrived && !pending_.front().estimate)
    pending_.pop_front();
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
  if (d.is_daemon_dead || d.is_loop_stalled) return;
  run_operator();
  if (has_robot_input_) readings_.robot_status = robot_input_;
  has_robot_input_ = false;
  readings_.loop.message_corrupt = is_input_corrupt_;
  is_input_corrupt_ = false;
  readings_.loop.wake_lateness = d.wake_lateness;
  readings_.loop.clock_divergence = d.has_clock_step ? milliseconds(5) : nanoseconds(0);
  readings_.loop.second_publisher = d.has_second_publisher;
  if (d.has_overflow) readings_.loop.internal_fault = true;
  readings_.registration = registration_;
  if (options_.bug != Bug::registration_kept_after_change) {
    if (d.is_registration_withdrawn) readings_.registration.is_loaded = false;
    if (d.is_registration_replaced) ++readings_.registration.id;
    if (d.is_zoomed) readings_.registration.optics_match = false;
  }
  const rt::ControlOutput output = rt::control_step(now_, parameters_, readings_, state_);
  readings_ = {};
  if (output.decision.changed) t_changed_ = now_;
  if (!d.is_publisher_dead) publish(output);
}

void World::publish(const rt::ControlOutput& output) {
  const safety::Decision& decision = output.decision;
  if (registration_counter_ == 0) {
    msg::RegistrationInfo info = bridge::dds::to_message(registration_, 1, 200, "ct", "sum");
    protect(info, kDaemon, ++registration_counter_, std::chrono::hours(1), clocks());
    guard_.take(info, clocks());
  }
  if (newest_estimate_ && now_ - t_health_sent_ >= milliseconds(30)) {
    bridge::dds::HealthFigures figures;
    figures.registration_id = newest_estimate_->registration_id;
    msg::TrackingHealth health = bridge::dds::to_message(newest_estimate_->motion, figures);
    protect(health, kDaemon, ++health_counter_, milliseconds(200), clocks());
    if (!disturbance.is_guard_dead) guard_.take(health, clocks());
    t_health_sent_ = now_;
  }
  const bool is_changed = decision.mode != sent_mode_ || decision.cause != sent_cause_;
  if (is_changed || now_ - t_stop_sent_ >= milliseconds(5)) {
    Envelope e;
    e.stop = bridge::dds::to_message(decision, t_changed_, output.t_evidence);
    if (options_.bug == Bug::publisher_claims_permission) {
      *e.stop = {};
      e.stop->mode = 3;
      e.stop->is_permitted = true;
    }
    protect(*e.stop, kDaemon, ++stop_counter_, milliseconds(20), clocks());
    send(e);
    t_stop_sent_ = now_;
    sent_mode_ = decision.mode;
    sent_cause_ = decision.cause;
  }
  publish_pose(output);
}

void World::publish_pose(const rt::ControlOutput& output) {
  if (output.decision.approved) {
    bridge::dds::PoseOrigin origin;
    origin.frame = output.frame;
    origin.t_exposure = output.t_exposure;
    origin.t_frame_received = output.t_frame_received;
    origin.p_target_robot_mm = output.decision.approved->T_robot_ct() * p_target_ct_mm_;
    last_pose_ = bridge::dds::to_message(*output.decision.approved, origin);
  } else if (options_.bug == Bug::publisher_repeats_last_pose ||
             options_.bug == Bug::publisher_claims_permission) {
    if (last_pose_) last_pose_->t_pose_ns = now_.count();
    if (last_pose_) last_pose_->t_exposure_ns = (now_ - milliseconds(30)).count();
  } else {
    return;
  }
  if (!last_pose_) return;
  Envelope e;
  e.pose = last_pose_;
  protect(*e.pose, kDaemon, ++pose_counter_, milliseconds(15), clocks());
  // With its own bug the publisher also says that motion is permitted.
  if (!output.decision.approved && options_.bug == Bug::publisher_repeats_last_pose) {
    Envelope s;
    s.stop.emplace();
    s.stop->mode = 3;
    s.stop->is_permitted = true;
    protect(*s.stop, kDaemon, ++stop_counter_, milliseconds(20), clocks());
    send(s);
  }
  send(e);
}

/// The way to guard and robot, and what can happen on it.
void World::send(Envelope e) {
  const Disturbance& d = disturbance;
  e.t_arrival = now_ + microseconds(100) + d.wire_delay;
  if (d.is_cut_to_robot || (e.stop && d.is_cut_stops) || (e.pose && d.is_cut_poses)) return;
  if (!recorded_ && e.pose) recorded_ = e;
  if (happens(d.loss)) return;
  if (d.is_truncated && e.pose) std::fill_n(&e.pose->covariance[18], 18, 0.0);
  if (happens(d.corruption)) {
    if (e.pose) e.pose->translation_mm[0] += 1;
    if (e.stop) e.stop->is_permitted = !e.stop->is_permitted;
  }
  if (happens(d.reordering)) e.t_arrival += milliseconds(2);
  wire_.push_back(e);
  if (happens(d.duplicates)) wire_.push_back(e);
}

void World::run_wire() {
  if (disturbance.is_replayed && recorded_) {
    Envelope e = *recorded_;
    e.t_arrival = now_;
    wire_.push_back(e);
  }
  if (disturbance.is_masqueraded && last_pose_) {
    Envelope e;
    e.pose = last_pose_;
    e.pose->t_pose_ns = now_.count();
    protect(*e.pose, kStranger, static_cast<std::uint32_t>(steps_), milliseconds(15), clocks());
    e.t_arrival = now_;
    wire_.push_back(e);
  }
  std::stable_sort(wire_.begin(), wire_.end(),
                   [](const Envelope& a, const Envelope& b) { return a.t_arrival < b.t_arrival; });
  while (!wire_.empty() && wire_.front().t_arrival <= now_) {
    const Envelope e = wire_.front();
    wire_.pop_front();
    if (e.stop) {
      client_.take(*e.stop, clocks());
      if (!disturbance.is_guard_dead) guard_.take(*e.stop, clocks());
    }
    if (e.pose) {
      client_.take(*e.pose, clocks());
      if (!disturbance.is_guard_dead) guard_.take(*e.pose, clocks());
    }
  }
}

void World::run_guard() {
  if (!options_.has_guard || disturbance.is_guard_dead) return;
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
  if (!pose) return seen;
  Eigen::Isometry3d T_robot_ct = Eigen::Isometry3d::Identity();
  const auto& q = pose->rotation_xyzw;
  T_robot_ct.linear() = Eigen::Quaterniond(q[3], q[0], q[1], q[2]).toRotationMatrix();
  T_robot_ct.translation() =
      Eigen::Vector3d(pose->translation_mm[0], pose->translation_mm[1], pose->translation_mm[2]);
  Eigen::Isometry3d T_true = T_robot_camera_ * T_camera_site_true() * registration_.T_site_ct;
  // With other optics or another patient's registration every pose is wrong.
  if (disturbance.is_zoomed || disturbance.is_registration_replaced ||
      disturbance.is_registration_withdrawn)
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
  if (!disturbance.is_guard_dead) guard_.take(status, clocks());
  if (disturbance.is_cut_from_robot || disturbance.is_daemon_dead) return;
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
  move_site();
  run_camera();
  deliver_estimates();
  run_loop();
  run_wire();
  run_guard();
  return run_robot();
}

}  // namespace holdfast::fault
