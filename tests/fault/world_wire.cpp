// SPDX-License-Identifier: Apache-2.0
// What the daemon publishes, and the way to guard and robot, with all that can happen on it.
#include <algorithm>

#include "tests/fault/world.hpp"

namespace holdfast::fault {
namespace {

using bridge::dds::protect;
using safety::Mode;
using safety::Reason;

}  // namespace

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
    tell_guard(health);
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
  if (options_.is_lively)
    e.t_arrival = t_newest_arrival_ =
        std::max(t_newest_arrival_, e.t_arrival + unrest(microseconds(1500)));
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
  const auto is_earlier = [](const Envelope& a, const Envelope& b) {
    return a.t_arrival < b.t_arrival;
  };
  if (!std::is_sorted(wire_.begin(), wire_.end(), is_earlier))
    std::stable_sort(wire_.begin(), wire_.end(), is_earlier);
  for (; !wire_.empty() && wire_.front().t_arrival <= now_; wire_.pop_front()) {
    const Envelope& e = wire_.front();
    if (e.stop) {
      client_.take(*e.stop, clocks());
      tell_guard(*e.stop);
    }
    if (e.pose) {
      client_.take(*e.pose, clocks());
      tell_guard(*e.pose);
    }
  }
}

}  // namespace holdfast::fault
