// SPDX-License-Identifier: Apache-2.0
#include "rt/outlets/ros2_outlet.hpp"

#include <cmath>

#include <fmt/format.h>

#include "perception/motion_estimate.hpp"

namespace holdfast::outlets {
namespace {

using bridge::ros2::Diagnostic;
using bridge::ros2::DiagnosticLevel;
using bridge::ros2::StampedTransform;
using observer::Level;

constexpr nanoseconds kDiagnosticsPeriod = std::chrono::milliseconds(200);

/// Columns: anterior, left, superior in the CT's left, posterior, superior.
Eigen::Isometry3d T_ct_patient() {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() << 0, 1, 0,  //
      -1, 0, 0,           //
      0, 0, 1;
  return T;
}

/// Columns: forward, left, up in the optical frame's right, down, forward.
Eigen::Isometry3d T_optical_camera() {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() << 0, -1, 0,  //
      0, 0, -1,            //
      1, 0, 0;
  return T;
}

DiagnosticLevel level_of(Level level) {
  switch (level) {
    case Level::permitted:
      return DiagnosticLevel::ok;
    case Level::hold:
    case Level::not_ready:
      return DiagnosticLevel::warn;
    case Level::stop:
      return DiagnosticLevel::error;
    case Level::no_data:
      break;
  }
  return DiagnosticLevel::stale;
}

std::string number(double value) {
  return std::isfinite(value) ? fmt::format("{:.6g}", value) : std::string("unknown");
}

Diagnostic permission(const observer::ObservedState& state, nanoseconds now) {
  const observer::Shown shown = state.shown(now);
  Diagnostic d{level_of(shown.level),
               "holdfast: permission",
               fmt::format("{}: {}", shown.word, shown.text),
               {}};
  d.values = {{"reason", std::string(shown.is_of_guard ? "guard: " : "") += shown.reason},
              {"level", std::string(name(shown.level))},
              {"use", "display only; a robot acts on holdfast_client alone"}};
  if (const msg::MotionStop* m = state.daemon(now))
    d.values.emplace_back("stop_id", fmt::to_string(m->stop_id));
  return d;
}

Diagnostic tracking(const observer::ObservedState& state, nanoseconds now) {
  const msg::TrackingHealth* h = state.health(now);
  if (h == nullptr)
    return {DiagnosticLevel::stale, "holdfast: tracking", "nothing is heard of the tracker", {}};
  const auto status = static_cast<perception::TrackingStatus>(h->status);
  const auto reason = static_cast<perception::TrackingReason>(h->reason);
  const bool is_lost = status == perception::TrackingStatus::lost;
  Diagnostic d{is_lost                                          ? DiagnosticLevel::error
               : status == perception::TrackingStatus::degraded ? DiagnosticLevel::warn
                                                                : DiagnosticLevel::ok,
               "holdfast: tracking",
               std::string(perception::name(status)),
               {}};
  d.values = {{"reason", std::string(perception::name(reason))},
              {"frame", fmt::to_string(h->frame)},
              {"inliers", fmt::to_string(h->inliers)},
              {"sigma_target_m", number(h->sigma_target_mm * 1e-3)},
              {"tracker_s", number(h->tracker_us * 1e-6)}};
  if (!is_lost && h->has_drift) d.values.emplace_back("drift_m", number(h->drift_um * 1e-6));
  return d;
}

Diagnostic registration(const observer::ObservedState& state, nanoseconds now) {
  const msg::RegistrationInfo* r = state.registration(now);
  if (r == nullptr) return {DiagnosticLevel::stale, "holdfast: registration", "none in force", {}};
  Diagnostic d{DiagnosticLevel::ok, "holdfast: registration", "in force", {}};
  d.values = {{"id", fmt::to_string(r->registration_id)},
              {"zoom", number(r->zoom)},
              {"focus_m", number(r->focus_mm * 1e-3)}};
  return d;
}

}  // namespace

StampedTransform to_transform(const LivePose& pose, const std::string& robot_frame) {
  return {robot_frame, kPatientFrame, pose.t_utc, pose.T_robot_ct * T_ct_patient()};
}

bridge::ros2::StampedPose to_pose(const LivePose& pose, const std::string& robot_frame) {
  const Eigen::Matrix3d R_robot_patient = (pose.T_robot_ct * T_ct_patient()).linear();
  return {robot_frame, pose.t_utc, pose.p_target_robot_mm, Eigen::Quaterniond(R_robot_patient),
          pose.covariance};
}

std::vector<StampedTransform> to_transforms(const LiveSite& site) {
  return {{kCtFrame, kSiteFrame, site.t_utc, site.T_site_ct.inverse()},
          {kSiteFrame, kOpticalFrame, site.t_utc, site.T_camera_site.inverse()}};
}

std::vector<StampedTransform> static_transforms(nanoseconds t_utc) {
  return {{kPatientFrame, kCtFrame, t_utc, T_ct_patient().inverse()},
          {kOpticalFrame, kCameraFrame, t_utc, T_optical_camera()}};
}

std::vector<Diagnostic> diagnostics(const observer::ObservedState& state, nanoseconds now) {
  return {permission(state, now), tracking(state, now), registration(state, now)};
}

bridge::ros2::StampedImage to_ros_image(const bridge::LivePicture& p) {
  return {kOpticalFrame, p.t_utc, p.width_px, p.height_px, p.channels, p.pixels};
}

Ros2Outlet::Ros2Outlet(const Ros2Settings& settings)
    : settings_(settings),
      mirror_({.domain = static_cast<std::uint32_t>(settings.domain),
               .configuration = settings.network,
               .security = {}},
              settings.has_images),
      feed_(settings.rate_hz) {
  mirror_.publish_static(static_transforms(bridge::dds::read_clocks().utc));
}

void Ros2Outlet::tell_diagnostics(const observer::ObservedState& state, bridge::dds::Clocks now) {
  const auto all = diagnostics(state, now.monotonic);
  if (all[0].message == told_ && now.monotonic - t_diagnostics_ < kDiagnosticsPeriod) return;
  (void)mirror_.publish(now.utc, all);
  told_ = all[0].message;
  t_diagnostics_ = now.monotonic;
}

void Ros2Outlet::tell_picture(const bridge::LivePicture* picture) {
  if (picture == nullptr || picture->t_exposure == t_picture_) return;
  (void)mirror_.publish(to_ros_image(*picture));
  t_picture_ = picture->t_exposure;
}

// What the middleware does not take is gone: the next is due in a moment, and nobody acts on it.
void Ros2Outlet::tell(const observer::ObservedState& state, bridge::dds::Clocks now) {
  tell_diagnostics(state, now);  // first: the reason comes before what it is the reason for
  if (const auto pose = feed_.next_pose(state, now.monotonic)) {
    const StampedTransform transform = to_transform(*pose, settings_.robot_frame);
    (void)mirror_.publish({&transform, 1});
    (void)mirror_.publish(to_pose(*pose, settings_.robot_frame));
  }
  if (const auto site = feed_.next_site(state, now.monotonic))
    (void)mirror_.publish(to_transforms(*site));
}

}  // namespace holdfast::outlets
