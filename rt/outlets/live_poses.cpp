// SPDX-License-Identifier: Apache-2.0
#include "rt/outlets/live_poses.hpp"

#include <cmath>

#include "perception/motion_estimate.hpp"
#include "safety/gate.hpp"

namespace holdfast::outlets {
namespace {

using observer::Level;

/// Nothing when a number is none, or the quaternion no rotation.
std::optional<Eigen::Isometry3d> isometry(const double (&translation_mm)[3],
                                          const double (&rotation_xyzw)[4]) noexcept {
  constexpr double kUnitTolerance = 1e-6;
  const Eigen::Quaterniond q(rotation_xyzw[3], rotation_xyzw[0], rotation_xyzw[1],
                             rotation_xyzw[2]);
  const Eigen::Vector3d t(translation_mm[0], translation_mm[1], translation_mm[2]);
  if (!t.allFinite() || !(std::abs(q.norm() - 1) <= kUnitTolerance)) return std::nullopt;
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = q.normalized().toRotationMatrix();
  T.translation() = t;
  return T;
}

/// The message's own pair of clocks takes its sender's monotonic time to UTC.
nanoseconds utc_of(const msg::Protection& sent, std::int64_t t_monotonic_ns) noexcept {
  return nanoseconds(sent.t_utc_ns - (sent.t_monotonic_ns - t_monotonic_ns));
}

bool may_show_site(const observer::ObservedState& state, nanoseconds now) noexcept {
  const observer::Shown shown = state.shown(now);
  if (shown.level == Level::permitted) return true;
  const msg::MotionStop* d = state.daemon(now);
  return shown.level == Level::not_ready && d != nullptr &&
         d->mode == static_cast<std::uint8_t>(safety::Mode::ready);
}

}  // namespace

std::optional<LivePose> live_pose(const observer::ObservedState& state, nanoseconds now) noexcept {
  const msg::CompensatedPose* m = state.pose(now);
  if (m == nullptr) return std::nullopt;
  const auto T_robot_ct = isometry(m->translation_mm, m->rotation_xyzw);
  LivePose pose;
  pose.p_target_robot_mm = Eigen::Map<const Eigen::Vector3d>(m->target_robot_mm);
  pose.covariance = Eigen::Map<const Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>(m->covariance);
  if (!T_robot_ct || !pose.p_target_robot_mm.allFinite() || !pose.covariance.allFinite())
    return std::nullopt;
  pose.T_robot_ct = *T_robot_ct;
  pose.t_utc = utc_of(m->protection, m->t_pose_ns);
  pose.counter = m->protection.counter;
  return pose;
}

std::optional<LiveSite> live_site(const observer::ObservedState& state, nanoseconds now) noexcept {
  const msg::TrackingHealth* h = state.health(now);
  const msg::RegistrationInfo* r = state.registration(now);
  if (h == nullptr || r == nullptr || !may_show_site(state, now)) return std::nullopt;
  if (h->status == static_cast<std::uint8_t>(perception::TrackingStatus::lost)) return std::nullopt;
  if (nanoseconds(h->protection.t_monotonic_ns - h->t_exposure_ns) > kSiteAgeMax)
    return std::nullopt;
  const auto T_camera_site = isometry(h->site_translation_mm, h->site_rotation_xyzw);
  const auto T_site_ct = isometry(r->translation_mm, r->rotation_xyzw);
  if (!T_camera_site || !T_site_ct) return std::nullopt;
  return LiveSite{utc_of(h->protection, h->t_exposure_ns), *T_camera_site, *T_site_ct, h->frame};
}

LiveFeed::LiveFeed(double rate_hz) : period_(std::llround(1e9 / rate_hz)) {}

std::optional<LivePose> LiveFeed::next_pose(const observer::ObservedState& state,
                                            nanoseconds now) noexcept {
  auto pose = live_pose(state, now);
  if (!pose || pose->counter == counter_ || now - t_pose_ < period_) return std::nullopt;
  counter_ = pose->counter;
  t_pose_ = now;
  return pose;
}

std::optional<LiveSite> LiveFeed::next_site(const observer::ObservedState& state,
                                            nanoseconds now) noexcept {
  auto site = live_site(state, now);
  if (!site || site->frame == frame_ || now - t_site_ < period_) return std::nullopt;
  frame_ = site->frame;
  t_site_ = now;
  return site;
}

}  // namespace holdfast::outlets
