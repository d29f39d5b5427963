// SPDX-License-Identifier: Apache-2.0
#include "rt/guard/guard_core.hpp"

#include <algorithm>
#include <cmath>
#include <string>

namespace holdfast::guard {
namespace {

using bridge::dds::Clocks;
using safety::DataId;

constexpr std::uint8_t kTrackingLost = 3;  // perception/motion_estimate.hpp TrackingStatus::lost
constexpr double kUnitTolerance = 1e-6;

safety::ReceiverParameters parameters(nanoseconds max_validity, std::uint32_t max_counter_step) {
  safety::ReceiverParameters result;
  result.max_validity = max_validity;
  result.max_counter_step = max_counter_step;
  return result;
}

template <std::size_t N>
bool are_finite(const double (&values)[N]) noexcept {
  return std::all_of(values, values + N, [](double v) { return std::isfinite(v); });
}

bool is_motion(const double (&t_mm)[3], const double (&q)[4]) noexcept {
  return are_finite(t_mm) && are_finite(q) &&
         std::abs(Eigen::Vector4d(q[0], q[1], q[2], q[3]).norm() - 1) <= kUnitTolerance;
}

Eigen::Isometry3d motion(const double (&t_mm)[3], const double (&q)[4]) noexcept {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = Eigen::Quaterniond(q[3], q[0], q[1], q[2]).normalized().toRotationMatrix();
  T.translation() = Eigen::Vector3d(t_mm[0], t_mm[1], t_mm[2]);
  return T;
}

bool is_within(double value, double limit) noexcept {
  return value <= limit;  // false for NaN
}

double seconds(nanoseconds t) noexcept {
  return std::chrono::duration<double>(t).count();
}

}  // namespace

std::string_view name(GuardCause cause) noexcept {
  switch (cause) {
    case GuardCause::none:
      return "none";
    case GuardCause::robot_disobeys:
      return "robot_disobeys";
    case GuardCause::pose_implausible:
      return "pose_implausible";
    case GuardCause::pose_jump:
      return "pose_jump";
    case GuardCause::message_bad:
      return "message_bad";
    case GuardCause::daemon_silent:
      return "daemon_silent";
    case GuardCause::health_silent:
      return "health_silent";
    case GuardCause::pose_silent:
      return "pose_silent";
    case GuardCause::pose_old:
      return "pose_old";
    case GuardCause::robot_silent:
      return "robot_silent";
    case GuardCause::robot_fault:
      return "robot_fault";
    case GuardCause::tracking_lost:
      return "tracking_lost";
    case GuardCause::not_registered:
      return "not_registered";
    case GuardCause::daemon_not_permitting:
      return "daemon_not_permitting";
    case GuardCause::recovering:
      return "recovering";
  }
  return "unknown";
}

std::string invalid_limit(const GuardLimits& l) {
  const auto bad_time = [](const char* key, nanoseconds value, int low_ms, int high_ms) {
    if (value >= milliseconds(low_ms) && value <= milliseconds(high_ms)) return std::string();
    return std::string(key) + " " + std::to_string(1e3 * seconds(value)) + " ms must be in [" +
           std::to_string(low_ms) + ", " + std::to_string(high_ms) + "] ms";
  };
  const auto bad_number = [](const char* key, double value, double high, const char* unit) {
    if (value > 0 && value <= high) return std::string();
    return std::string(key) + " " + std::to_string(value) + " " + unit + " must be in (0, " +
           std::to_string(high) + "] " + unit;
  };
  const std::string all[] = {bad_time("daemon_silence_max", l.daemon_silence_max, 6, 20),
                             bad_time("pose_silence_max", l.pose_silence_max, 2, 20),
                             bad_time("pose_age_max", l.pose_age_max, 10, 200),
                             bad_time("health_silence_max", l.health_silence_max, 100, 1000),
                             bad_time("robot_silence_max", l.robot_silence_max, 20, 500),
                             bad_time("robot_obeys_within", l.robot_obeys_within, 20, 500),
                             bad_time("recovery", l.recovery, 1, 1000),
                             bad_number("displacement_max", l.displacement_max_mm, 50, "mm"),
                             bad_number("rotation_max", l.rotation_max_rad, 1, "rad"),
                             bad_number("speed_max", l.speed_max_mm_per_s, 500, "mm/s"),
                             bad_number("pose_step_max", l.pose_step_max_mm, 5, "mm"),
                             bad_number("tracking_gap_max", l.tracking_gap_max_mm, 20, "mm"),
                             bad_number("target_error_max", l.target_error_max_mm, 1, "mm")};
  for (const std::string& problem : all) {
    if (!problem.empty()) return problem;
  }
  return {};
}

GuardCore::GuardCore(const GuardLimits& limits, const Eigen::Isometry3d& T_robot_camera) noexcept
    : limits_(limits),
      T_robot_camera_(T_robot_camera),
      stops_(DataId::motion_stop, parameters(milliseconds(20), 1)),
      poses_(DataId::compensated_pose, parameters(milliseconds(20), 1)),
      health_(DataId::tracking_health, parameters(limits.health_silence_max, 4)),
      registrations_(DataId::registration_info, parameters(std::chrono::hours(1), ~0U >> 1U)),
      robot_(DataId::robot_status, parameters(limits.robot_silence_max, 1)) {}

template <class M>
bool GuardCore::is_good(const M& message, safety::Receiver& receiver, Clocks now) noexcept {
  if (bridge::dds::check(message, receiver, now) == safety::Verdict::accepted) return true;
  has_bad_message_ = true;
  return false;
}

void GuardCore::take(const msg::MotionStop& m, Clocks now) noexcept {
  const bool is_first = stops_.source() == 0;
  if (!is_good(m, stops_, now)) return;
  t_stop_ = now.monotonic;
  if (m.is_permitted && (!is_daemon_permitting_ || is_first)) t_permitting_ = now.monotonic;
  is_daemon_permitting_ = m.is_permitted;
  if (!is_daemon_permitting_) {
    latched_ = GuardCause::none;
    has_pose_ = false;  // the next permission starts from a pose of its own
  }
}

void GuardCore::take(const msg::RegistrationInfo& m, Clocks now) noexcept {
  if (!is_good(m, registrations_, now)) return;
  has_registration_ =
      m.is_loaded && is_motion(m.translation_mm, m.rotation_xyzw) && are_finite(m.target_ct_mm);
  if (!has_registration_) return;
  registration_id_ = m.registration_id;
  T_site_ct_ = motion(m.translation_mm, m.rotation_xyzw);
  p_target_ct_mm_ = Eigen::Vector3d(m.target_ct_mm[0], m.target_ct_mm[1], m.target_ct_mm[2]);
}

void GuardCore::take(const msg::TrackingHealth& m, Clocks now) noexcept {
  if (!is_good(m, health_, now)) return;
  t_health_ = now.monotonic;
  health_registration_id_ = m.registration_id;
  is_tracking_ = m.status < kTrackingLost && is_motion(m.site_translation_mm, m.site_rotation_xyzw);
  if (is_tracking_) T_camera_site_ = motion(m.site_translation_mm, m.site_rotation_xyzw);
}

void GuardCore::take(const msg::RobotStatus& m, Clocks now) noexcept {
  if (!is_good(m, robot_, now)) return;
  t_robot_ = now.monotonic;
  is_robot_enabled_ = m.is_enabled;
  has_robot_fault_ = m.has_fault;
}

/// Against registration, keyframe and the newest frame's own estimate:
///   T_camera_site = T_robot_camera^-1 · T_robot_ct · T_site_ct^-1
GuardCause GuardCore::content_fault(const msg::CompensatedPose& m) const noexcept {
  if (!is_motion(m.translation_mm, m.rotation_xyzw) || !are_finite(m.target_robot_mm))
    return GuardCause::pose_implausible;
  if (!has_registration_ || !is_tracking_) return GuardCause::none;  // named as what it is
  const Eigen::Isometry3d T_robot_ct = motion(m.translation_mm, m.rotation_xyzw);
  const Eigen::Vector3d p_target_robot_mm = T_robot_ct * p_target_ct_mm_;
  const Eigen::Vector3d p_published_mm(m.target_robot_mm[0], m.target_robot_mm[1],
                                       m.target_robot_mm[2]);
  const Eigen::Isometry3d T_camera_site =
      T_robot_camera_.inverse() * T_robot_ct * T_site_ct_.inverse();
  const Eigen::Vector3d p_site_mm = T_site_ct_ * p_target_ct_mm_;
  const double displacement_mm = (T_camera_site * p_site_mm - p_site_mm).norm();
  const double angle_rad = Eigen::AngleAxisd(T_camera_site.linear()).angle();
  const double gap_mm = (T_camera_site * p_site_mm - T_camera_site_ * p_site_mm).norm();
  const bool is_plausible =
      is_within((p_published_mm - p_target_robot_mm).norm(), limits_.target_error_max_mm) &&
      is_within(displacement_mm, limits_.displacement_max_mm) &&
      is_within(angle_rad, limits_.rotation_max_rad) &&
      is_within(gap_mm, limits_.tracking_gap_max_mm);
  if (!is_plausible) return GuardCause::pose_implausible;
  if (!has_pose_) return GuardCause::none;
  const double dt = std::max(0.0, seconds(nanoseconds(m.t_pose_ns) - t_predicted_));
  const double reach_mm = limits_.pose_step_max_mm + limits_.speed_max_mm_per_s * dt;
  return is_within((p_target_robot_mm - p_target_robot_mm_).norm(), reach_mm)
             ? GuardCause::none
             : GuardCause::pose_jump;
}

void GuardCore::take(const msg::CompensatedPose& m, Clocks now) noexcept {
  if (!is_good(m, poses_, now)) return;
  const GuardCause fault = content_fault(m);
  if (fault != GuardCause::none) {
    if (latched_ == GuardCause::none) latched_ = fault;
    return;
  }
  t_pose_ = now.monotonic;
  t_predicted_ = nanoseconds(m.t_pose_ns);
  pose_age_ = nanoseconds(m.t_pose_ns - m.t_exposure_ns);
  pose_registration_id_ = m.registration_id;
  p_target_robot_mm_ = motion(m.translation_mm, m.rotation_xyzw) * p_target_ct_mm_;
  has_pose_ = true;
}

/// What speaks against permission at `now`, the gravest first; none when nothing does.
GuardCause GuardCore::fault(nanoseconds now) const noexcept {
  const auto is_silent = [now](nanoseconds t, nanoseconds limit) {
    return t == nanoseconds::zero() || now - t > limit;
  };
  if (has_disobeyed_) return GuardCause::robot_disobeys;
  if (latched_ != GuardCause::none) return latched_;
  if (has_bad_message_) return GuardCause::message_bad;
  if (is_silent(t_stop_, limits_.daemon_silence_max)) return GuardCause::daemon_silent;
  if (is_silent(t_health_, limits_.health_silence_max)) return GuardCause::health_silent;
  if (is_daemon_permitting_ &&
      is_silent(std::max(t_pose_, t_permitting_), limits_.pose_silence_max))
    return GuardCause::pose_silent;
  if (has_pose_ && pose_age_ > limits_.pose_age_max) return GuardCause::pose_old;
  if (is_silent(t_robot_, limits_.robot_silence_max)) return GuardCause::robot_silent;
  if (has_robot_fault_) return GuardCause::robot_fault;
  if (!is_tracking_) return GuardCause::tracking_lost;
  const bool is_registered = has_registration_ && health_registration_id_ == registration_id_ &&
                             (!has_pose_ || pose_registration_id_ == registration_id_);
  if (!is_registered) return GuardCause::not_registered;
  if (!is_daemon_permitting_ || !has_pose_ || poses_.source() != stops_.source())
    return GuardCause::daemon_not_permitting;
  return GuardCause::none;
}

/// A robot that stays enabled against the guard's word can be stopped by nothing on the network.
void GuardCore::watch_robot(nanoseconds now) noexcept {
  const bool is_against_us = is_robot_enabled_ && !answer_.is_permitted;
  if (is_against_us && !is_enabled_against_us_) t_enabled_against_us_ = now;
  is_enabled_against_us_ = is_against_us;
  // By a status that came so late; one that never came is silence.
  if (is_against_us && t_robot_ - t_enabled_against_us_ > limits_.robot_obeys_within)
    has_disobeyed_ = true;
}

const GuardAnswer& GuardCore::decide(nanoseconds now) noexcept {
  watch_robot(now);
  GuardCause cause = fault(now);
  has_bad_message_ = false;
  const bool is_well = cause == GuardCause::none;
  if (is_well && !was_well_) t_well_since_ = now;
  was_well_ = is_well;
  if (is_well && now - t_well_since_ < limits_.recovery) cause = GuardCause::recovering;
  if (cause != answer_.cause) answer_.t_changed = now;
  answer_.cause = cause;
  answer_.is_permitted = cause == GuardCause::none;
  answer_.daemon_source = poses_.source();
  answer_.may_stroke_watchdog = !has_disobeyed_;
  return answer_;
}

}  // namespace holdfast::guard
