// SPDX-License-Identifier: Apache-2.0
// The site, the camera above it and the tracker: what the control side is told, and when.
#include <cmath>
#include <numbers>

#include "tests/fault/world.hpp"
#include "tests/rt/virtual_inputs.hpp"

namespace holdfast::fault {
namespace {

using safety::Reason;

constexpr nanoseconds kFramePeriod = microseconds(33'333);

}  // namespace

void World::draw_motion() {
  const double heading_rad = uniform(0, 2 * std::numbers::pi);
  motion_.direction =
      Eigen::Vector3d(std::cos(heading_rad), std::sin(heading_rad), uniform(-0.2, 0.2));
  motion_.amplitude_mm = uniform(0, 2);
  motion_.rate_rad_per_s = uniform(0.2, 1.5);
  motion_.phase_rad = uniform(0, 2 * std::numbers::pi);
  motion_.turn_rad = uniform(0, 0.02);
  motion_.turn_rate_rad_per_s = uniform(0.2, 1.5);
  motion_.turn_phase_rad = uniform(0, 2 * std::numbers::pi);
}

nanoseconds World::unrest(nanoseconds most) {
  if (!options_.is_lively) return nanoseconds(0);
  return nanoseconds(std::uniform_int_distribution<std::int64_t>(0, most.count())(random_));
}

/// To and fro, and what the disturbance adds.
Eigen::Isometry3d World::T_camera_site_true() const {
  const double s = std::chrono::duration<double>(now_).count();
  const Motion& m = motion_;
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.translation() = m.amplitude_mm * std::sin(m.rate_rad_per_s * s + m.phase_rad) * m.direction;
  T.translation().x() += extra_x_mm_;
  const double turn_rad = m.turn_rad * std::sin(m.turn_rate_rad_per_s * s + m.turn_phase_rad);
  const Eigen::AngleAxisd turn(turn_rad + extra_turn_rad_, Eigen::Vector3d::UnitZ());
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

/// A lively room's: in all six directions about the pivot, as large as the covariance says.
void World::add_noise(perception::MotionEstimate& motion, std::normal_distribution<double>& noise) {
  auto t_mm = motion.T_camera_site.translation();
  if (!options_.is_lively) {
    for (int axis = 0; axis < 3; ++axis) t_mm[axis] += noise(random_);
    return;
  }
  Eigen::Matrix<double, 6, 1> error;
  for (int i = 0; i < 6; ++i)
    error[i] = std::sqrt(motion.covariance(i, i)) * noise(random_) / noise.stddev();
  const Eigen::Vector3d p_pivot_mm = motion.T_camera_site * motion.p_pivot_site_mm;
  const double angle_rad = error.tail<3>().norm();
  const Eigen::AngleAxisd turn(angle_rad, error.tail<3>() / angle_rad);
  motion.T_camera_site.linear() = turn * motion.T_camera_site.linear();
  t_mm = p_pivot_mm + error.head<3>() - motion.T_camera_site.linear() * motion.p_pivot_site_mm;
}

perception::MotionEstimate World::estimate() {
  const Disturbance& d = disturbance;
  perception::MotionEstimate motion = rt::testing::healthy_estimate(now_ + d.exposure_error);
  motion.T_camera_site = T_camera_site_true();
  std::normal_distribution<double> noise(0, 0.003);
  add_noise(motion, noise);
  motion.T_camera_site.translation().y() += d.estimate_offset_mm + estimate_slide_mm_;
  // A tracker that does not know of a zoom takes it for an approach (docs/safety/hazards.md).
  const double pivot_mm = motion.p_pivot_site_mm.z();
  const double seen_mm = pivot_mm + motion.T_camera_site.translation().z();
  motion.T_camera_site.translation().z() = seen_mm / zoom_true() - pivot_mm;
  motion.scale = pivot_mm / (pivot_mm + motion.T_camera_site.translation().z());
  const double wrong_mm = std::abs(d.estimate_offset_mm + estimate_slide_mm_);
  motion.drift_um = 5 + (d.is_drift_seen ? 1e3 * wrong_mm : 0);
  motion.has_drift = !d.has_no_drift;
  if (options_.bug == Bug::drift_not_measured) motion.drift_um = 5;
  if (options_.bug != Bug::covariance_not_filled_honestly)
    motion.covariance *= d.covariance_scale * d.covariance_scale;
  if (d.covariance_scale > 1)
    motion.T_camera_site.translation().y() +=
        0.01 * d.covariance_scale * noise(random_) / noise.stddev();
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
  p.t_arrival = now_ + milliseconds(6) + d.frame_delay + unrest(milliseconds(2));
  p.t_estimate =
      now_ + milliseconds(16) + d.frame_delay + d.tracker_delay + unrest(milliseconds(10));
  p.arrival.frame = frame_;
  p.arrival.t_exposure = now_ + d.exposure_error;
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
      p.arrival.t_received = now_;  // later than it came if nobody was awake to take it
      if (readings_.arrival_count < rt::Readings::kMaxArrivals)
        readings_.arrivals[readings_.arrival_count++] = p.arrival;
      else
        readings_.loop.internal_fault = true;
    }
    if (p.estimate && p.t_estimate <= now_ && p.has_arrived) {
      p.estimate->t_frame_received = p.arrival.t_received;
      p.estimate->t_published = now_;
      readings_.estimate = newest_estimate_ = p.estimate;
      p.estimate.reset();
    }
  }
  while (!pending_.empty() && pending_.front().has_arrived && !pending_.front().estimate)
    pending_.pop_front();
}

}  // namespace holdfast::fault
