// SPDX-License-Identifier: Apache-2.0
// Every field of every message, in the order of bridge/idl/holdfast.idl. The CRC is computed over
// what is listed here, so a field that is missing here is unprotected: the tests compare the list
// with the generated types' sizes.
#pragma once

#include <tuple>
#include <type_traits>

#include "bridge/dds/message_types.hpp"

namespace holdfast::msg {

/// Protection without its CRC.
template <class P>
requires std::same_as<std::remove_const_t<P>, Protection>
[[nodiscard]] constexpr auto fields(P& p) noexcept {
  return std::tie(p.version, p.data_id, p.source, p.counter, p.t_monotonic_ns, p.t_utc_ns,
                  p.validity_us);
}

template <class M>
requires std::same_as<std::remove_const_t<M>, CompensatedPose>
[[nodiscard]] constexpr auto fields(M& m) noexcept {
  return std::tie(m.t_pose_ns, m.t_exposure_ns, m.t_frame_received_ns, m.frame, m.registration_id,
                  m.translation_mm, m.rotation_xyzw, m.covariance, m.target_robot_mm);
}

template <class M>
requires std::same_as<std::remove_const_t<M>, MotionStop>
[[nodiscard]] constexpr auto fields(M& m) noexcept {
  return std::tie(m.mode, m.cause, m.is_permitted, m.is_latched, m.stop_id, m.reasons,
                  m.t_changed_ns, m.t_evidence_ns);
}

template <class M>
requires std::same_as<std::remove_const_t<M>, TrackingHealth>
[[nodiscard]] constexpr auto fields(M& m) noexcept {
  return std::tie(m.frame, m.registration_id, m.t_exposure_ns, m.status, m.reason, m.features,
                  m.matches, m.inliers, m.inlier_spread, m.reprojection_rms_px, m.dx_um, m.dy_um,
                  m.rotation_rad, m.scale, m.has_drift, m.drift_um, m.site_translation_mm,
                  m.site_rotation_xyzw, m.sigma_target_mm, m.clock_offset_sigma_us, m.tracker_us,
                  m.frames_received, m.frames_incomplete, m.frames_missing, m.frames_skipped,
                  m.cycles, m.cycles_missed, m.wake_lateness_max_us, m.step_max_us, m.advisories);
}

template <class M>
requires std::same_as<std::remove_const_t<M>, RegistrationInfo>
[[nodiscard]] constexpr auto fields(M& m) noexcept {
  return std::tie(m.is_loaded, m.registration_id, m.translation_mm, m.rotation_xyzw, m.covariance,
                  m.target_ct_mm, m.zoom, m.focus_mm, m.ct_identity, m.checksum);
}

template <class M>
requires std::same_as<std::remove_const_t<M>, RobotStatus>
[[nodiscard]] constexpr auto fields(M& m) noexcept {
  return std::tie(m.is_enabled, m.has_fault, m.fault_code, m.poses_accepted, m.poses_refused,
                  m.refusal, m.last_pose_counter);
}

template <class M>
requires std::same_as<std::remove_const_t<M>, OperatorCommand>
[[nodiscard]] constexpr auto fields(M& m) noexcept {
  return std::tie(m.command, m.stop_id);
}

template <class M>
requires std::same_as<std::remove_const_t<M>, GuardPermission>
[[nodiscard]] constexpr auto fields(M& m) noexcept {
  return std::tie(m.is_permitted, m.cause, m.daemon_source, m.t_changed_ns);
}

/// Calls f with each field of the message but the CRC: scalars one by one (array elements in
/// order), a string as its whole char array.
template <class M, class F>
constexpr void for_each_field(M& message, F&& f) {
  const auto visit = [&f](auto& field) {
    using Field = std::remove_reference_t<decltype(field)>;
    if constexpr (std::is_array_v<Field> &&
                  !std::is_same_v<std::remove_cv_t<std::remove_extent_t<Field>>, char>) {
      for (auto& element : field) f(element);
    } else {
      f(field);
    }
  };
  const auto visit_all = [&visit](auto&... all) { (visit(all), ...); };
  std::apply(visit_all, fields(message.protection));
  std::apply(visit_all, fields(message));
}

}  // namespace holdfast::msg
