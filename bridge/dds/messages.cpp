// SPDX-License-Identifier: Apache-2.0
#include "bridge/dds/messages.hpp"

#include <algorithm>
#include <cstring>
#include <limits>

namespace holdfast::bridge::dds {
namespace {

void put(const Eigen::Vector3d& v, double (&to)[3]) noexcept {
  Eigen::Map<Eigen::Vector3d>{to} = v;
}

void put(const Eigen::Matrix3d& rotation, double (&xyzw)[4]) noexcept {
  Eigen::Map<Eigen::Vector4d>{xyzw} = Eigen::Quaterniond(rotation).normalized().coeffs();
}

void put(const safety::Matrix6d& covariance, double (&row_major)[36]) noexcept {
  Eigen::Map<Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>{row_major} = covariance;
}

template <std::size_t N>
void put(std::string_view text, char (&to)[N]) noexcept {
  const std::size_t length = std::min(text.size(), N - 1);
  std::memcpy(to, text.data(), length);
  to[length] = '\0';
}

std::uint32_t microseconds(std::chrono::nanoseconds t) noexcept {
  const auto us = std::chrono::duration_cast<std::chrono::microseconds>(t).count();
  return static_cast<std::uint32_t>(
      std::clamp<std::int64_t>(us, 0, std::numeric_limits<std::uint32_t>::max()));
}

void put_motion(const perception::MotionEstimate& estimate, msg::TrackingHealth& m) noexcept {
  m.inlier_spread = estimate.inlier_spread;
  m.reprojection_rms_px = estimate.reprojection_rms_px;
  m.dx_um = estimate.dx_um;
  m.dy_um = estimate.dy_um;
  m.rotation_rad = estimate.rotation_rad;
  m.scale = estimate.scale;
  m.has_drift = estimate.has_drift;
  m.drift_um = estimate.drift_um;
  put(estimate.T_camera_site.translation(), m.site_translation_mm);
  put(estimate.T_camera_site.linear(), m.site_rotation_xyzw);
}

void put_no_motion(msg::TrackingHealth& m) noexcept {
  constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();
  m.reprojection_rms_px = m.dx_um = m.dy_um = m.rotation_rad = m.scale = m.drift_um = kUnknown;
  std::ranges::fill(m.site_translation_mm, kUnknown);
  std::ranges::fill(m.site_rotation_xyzw, kUnknown);
}

}  // namespace

msg::CompensatedPose to_message(const safety::ApprovedPose& pose,
                                const PoseOrigin& origin) noexcept {
  msg::CompensatedPose m{};
  m.t_pose_ns = pose.t_pose().count();
  m.t_exposure_ns = origin.t_exposure.count();
  m.t_frame_received_ns = origin.t_frame_received.count();
  m.frame = origin.frame;
  m.registration_id = pose.registration_id();
  put(pose.T_robot_ct().translation(), m.translation_mm);
  put(pose.T_robot_ct().linear(), m.rotation_xyzw);
  put(pose.covariance(), m.covariance);
  put(origin.p_target_robot_mm, m.target_robot_mm);
  return m;
}

msg::MotionStop to_message(const safety::Decision& decision, safety::Timestamp t_changed,
                           safety::Timestamp t_evidence) noexcept {
  msg::MotionStop m{};
  m.mode = static_cast<std::uint8_t>(decision.mode);
  m.cause = static_cast<std::uint8_t>(decision.cause);
  m.is_permitted = decision.mode == safety::Mode::permitted && decision.approved.has_value();
  m.is_latched = decision.mode == safety::Mode::stop_latched;
  m.stop_id = decision.stop_id;
  m.reasons = decision.reasons.bits();
  m.t_changed_ns = t_changed.count();
  m.t_evidence_ns = t_evidence.count();
  return m;
}

msg::TrackingHealth to_message(const perception::MotionEstimate& estimate,
                               const HealthFigures& figures) noexcept {
  msg::TrackingHealth m{};
  m.frame = figures.frame;
  m.registration_id = figures.registration_id;
  m.t_exposure_ns = estimate.t_exposure.count();
  m.status = static_cast<std::uint8_t>(estimate.status);
  m.reason = static_cast<std::uint8_t>(estimate.reason);
  m.features = estimate.features;
  m.matches = estimate.matches;
  m.inliers = estimate.inliers;
  if (estimate.status == perception::TrackingStatus::lost)
    put_no_motion(m);
  else
    put_motion(estimate, m);
  m.sigma_target_mm = figures.sigma_target_mm;
  m.clock_offset_sigma_us = figures.clock_offset_sigma_us;
  m.tracker_us = microseconds(estimate.times.total);
  m.frames_received = figures.frames_received;
  m.frames_incomplete = figures.frames_incomplete;
  m.frames_missing = figures.frames_missing;
  m.frames_skipped = figures.frames_skipped;
  m.cycles = figures.cycles;
  m.cycles_missed = figures.cycles_missed;
  m.wake_lateness_max_us = figures.wake_lateness_max_us;
  m.step_max_us = figures.step_max_us;
  m.advisories = figures.advisories.bits();
  return m;
}

msg::RegistrationInfo to_message(const safety::RegistrationInput& registration, double zoom,
                                 double focus_mm, std::string_view ct_identity,
                                 std::string_view checksum) noexcept {
  msg::RegistrationInfo m{};
  if (!registration.is_loaded) return m;
  m.is_loaded = true;
  m.registration_id = registration.id;
  put(registration.T_site_ct.translation(), m.translation_mm);
  put(registration.T_site_ct.linear(), m.rotation_xyzw);
  put(registration.covariance, m.covariance);
  put(registration.T_site_ct.inverse() * registration.p_target_site_mm, m.target_ct_mm);
  m.zoom = zoom;
  m.focus_mm = focus_mm;
  put(ct_identity, m.ct_identity);
  put(checksum, m.checksum);
  return m;
}

safety::RobotInput to_input(const msg::RobotStatus& status, safety::Timestamp t_received) noexcept {
  return {.has_status = true, .t_last_status = t_received, .has_fault = status.has_fault};
}

safety::OperatorInput to_input(const msg::OperatorCommand& command) noexcept {
  constexpr auto kLast = static_cast<std::uint8_t>(safety::Command::confirm);
  const auto code = command.command <= kLast ? static_cast<safety::Command>(command.command)
                                             : safety::Command::stop;
  return {.command = code, .stop_id = command.stop_id};
}

bool PosePublisher::publish(const safety::ApprovedPose& pose, const PoseOrigin& origin) noexcept {
  auto message = to_message(pose, origin);
  return writer_.publish(message, pose.validity());
}

}  // namespace holdfast::bridge::dds
