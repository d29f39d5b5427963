// SPDX-License-Identifier: Apache-2.0
#include "rt/dashboard/snapshot.hpp"

#include <cmath>

#include <Eigen/Geometry>
#include <nlohmann/json.hpp>

#include "perception/motion_estimate.hpp"
#include "rt/reason_text.hpp"
#include "safety/gate.hpp"

namespace holdfast::dashboard {
namespace {

using nlohmann::json;
using safety::Reason;
using safety::ReasonSet;

json number(double value) {
  return std::isfinite(value) ? json(value) : json();
}

double milliseconds_of(nanoseconds duration) {
  return std::chrono::duration<double, std::milli>(duration).count();
}

json to_json(const Shown& shown) {
  return {{"level", name(shown.level)},
          {"word", shown.word},
          {"reason", shown.reason},
          {"text", shown.text},
          {"is_of_guard", shown.is_of_guard}};
}

json reason_list(std::uint64_t bits) {
  json list = json::array();
  for (unsigned code = 1; code < 64; ++code) {
    if (((bits >> code) & 1U) == 0) continue;
    const auto reason = static_cast<Reason>(code);
    list.push_back({{"name", safety::name(reason)},
                    {"severity", rt::name(safety::severity(reason))},
                    {"text", rt::sentence(reason)}});
  }
  return list;
}

/// The reasons from `first` to `last`: what one device has to do with.
std::uint64_t between(std::uint64_t bits, Reason first, Reason last) {
  std::uint64_t mask = 0;
  for (auto code = static_cast<unsigned>(first); code <= static_cast<unsigned>(last); ++code)
    mask |= std::uint64_t{1} << code;
  return bits & mask;
}

json to_json(const msg::MotionStop& m) {
  const auto mode = static_cast<safety::Mode>(m.mode);
  return {{"mode", safety::name(mode)},
          {"cause", safety::name(static_cast<Reason>(m.cause))},
          {"is_permitted", m.is_permitted},
          {"is_latched", m.is_latched},
          {"stop_id", m.stop_id},
          {"counter", m.protection.counter},
          {"for_ms", static_cast<double>(m.protection.t_monotonic_ns - m.t_changed_ns) / 1e6},
          {"reasons", reason_list(m.reasons)}};
}

json to_json(const msg::TrackingHealth& m) {
  const auto status = static_cast<perception::TrackingStatus>(m.status);
  const auto reason = static_cast<perception::TrackingReason>(m.reason);
  const bool is_lost = status == perception::TrackingStatus::lost;
  const auto measured = [is_lost](double value) { return is_lost ? json() : number(value); };
  return {{"frame", m.frame},
          {"status", perception::name(status)},
          {"reason", perception::name(reason)},
          {"features", m.features},
          {"matches", m.matches},
          {"inliers", m.inliers},
          {"inlier_spread", measured(m.inlier_spread)},
          {"rms_px", measured(m.reprojection_rms_px)},
          {"dx_um", measured(m.dx_um)},
          {"dy_um", measured(m.dy_um)},
          {"rotation_mrad", measured(m.rotation_rad * 1e3)},
          {"scale", measured(m.scale)},
          {"drift_um", m.has_drift ? measured(m.drift_um) : json()},
          {"sigma_target_mm", number(m.sigma_target_mm)},
          {"tracker_ms", m.tracker_us / 1e3}};
}

json camera_json(const msg::TrackingHealth* h, const msg::MotionStop* d) {
  json result{{"faults", d == nullptr ? json()
                                      : reason_list(between(d->reasons, Reason::camera_disconnected,
                                                            Reason::frame_time_invalid))}};
  if (h == nullptr) return result;
  result.update({{"received", h->frames_received},
                 {"incomplete", h->frames_incomplete},
                 {"missing", h->frames_missing},
                 {"skipped", h->frames_skipped},
                 {"clock_sigma_us", number(h->clock_offset_sigma_us)}});
  return result;
}

json microscope_json(const msg::TrackingHealth* h, const msg::MotionStop* d) {
  if (d == nullptr) return {{"faults", json()}};
  std::uint64_t bits = between(d->reasons, Reason::microscope_missing, Reason::optics_moving) |
                       between(d->reasons, Reason::optics_changed, Reason::optics_changed);
  if (h != nullptr)
    bits |= between(h->advisories, Reason::optics_unwatched, Reason::virtual_microscope);
  return {{"faults", reason_list(bits)}};
}

json loop_json(const msg::TrackingHealth& h) {
  return {{"cycles", h.cycles},
          {"missed", h.cycles_missed},
          {"wake_lateness_max_us", h.wake_lateness_max_us},
          {"step_max_us", h.step_max_us},
          {"advisories", reason_list(h.advisories)}};
}

/// 1 sigma (root of the three variances' sum) of the target by the registration alone: its error
/// turns about the ct origin's image, dp = dt + r x (R p_ct).
double predicted_tre_mm(const msg::RegistrationInfo& m) {
  using Matrix6 = Eigen::Matrix<double, 6, 6, Eigen::RowMajor>;
  const Eigen::Quaterniond q(m.rotation_xyzw[3], m.rotation_xyzw[0], m.rotation_xyzw[1],
                             m.rotation_xyzw[2]);
  const Eigen::Vector3d a = q * Eigen::Map<const Eigen::Vector3d>(m.target_ct_mm);
  Eigen::Matrix<double, 3, 6> J;
  J << Eigen::Matrix3d::Identity(),
      (Eigen::Matrix3d() << 0, a.z(), -a.y(), -a.z(), 0, a.x(), a.y(), -a.x(), 0).finished();
  return std::sqrt((J * Eigen::Map<const Matrix6>(m.covariance) * J.transpose()).trace());
}

json to_json(const msg::RegistrationInfo& m) {
  return {{"id", std::to_string(m.registration_id)},  // 64 bits are more than a JSON reader keeps
          {"predicted_tre_mm", number(predicted_tre_mm(m))},
          {"target_ct_mm", {m.target_ct_mm[0], m.target_ct_mm[1], m.target_ct_mm[2]}},
          {"zoom", m.zoom},
          {"focus_mm", m.focus_mm},
          {"ct", m.ct_identity},
          {"checksum", m.checksum}};
}

json to_json(const msg::RobotStatus& m) {
  return {{"is_enabled", m.is_enabled},
          {"has_fault", m.has_fault},
          {"fault_code", m.fault_code},
          {"poses_accepted", m.poses_accepted},
          {"poses_refused", m.poses_refused}};
}

json to_json(const msg::GuardPermission& m) {
  const auto cause = static_cast<guard::GuardCause>(m.cause);
  return {{"is_permitted", m.is_permitted},
          {"cause", guard::name(cause)},
          {"text", rt::sentence(cause)}};
}

template <class M>
json optional_json(const M* message) {
  return message == nullptr ? json() : to_json(*message);
}

json to_json(const Histogram& h) {
  return {{"count", h.count},
          {"p50_ms", h.percentile_ms(0.5)},
          {"p99_ms", h.percentile_ms(0.99)},
          {"max_ms", milliseconds_of(h.max)},
          {"bins", h.counts}};
}

json to_json(const StopEvent& e) {
  json result = to_json(e.shown);
  result.update({{"t_utc_ms", e.t_utc_ns / 1'000'000},
                 {"stop_id", e.stop_id},
                 {"reasons", reason_list(e.reasons)},
                 {"duration_ms", e.duration ? json(milliseconds_of(*e.duration)) : json()}});
  return result;
}

}  // namespace

std::string state_json(const ObservedState& state, bridge::dds::Clocks now) {
  const nanoseconds t = now.monotonic;
  const msg::MotionStop* d = state.daemon(t);
  const msg::TrackingHealth* h = state.health(t);
  return json{{"t_utc_ms", now.utc.count() / 1'000'000},
              {"shown", to_json(state.shown(t))},
              {"daemon", optional_json(d)},
              {"guard", optional_json(state.guard(t))},
              {"robot", optional_json(state.robot(t))},
              {"tracking", optional_json(h)},
              {"camera", camera_json(h, d)},
              {"microscope", microscope_json(h, d)},
              {"loop", h == nullptr ? json() : loop_json(*h)},
              {"registration", optional_json(state.registration(t))},
              {"messages_refused", state.refused()}}
      .dump(-1, ' ', false, json::error_handler_t::replace);
}

std::string history_json(const ObservedState& state) {
  json stops = json::array();
  for (auto event = state.stops().rbegin(); event != state.stops().rend(); ++event)
    stops.push_back(to_json(*event));
  return json{{"stops", std::move(stops)},
              {"exposure_to_pose", to_json(state.exposure_to_pose())},
              {"tracker", to_json(state.tracker())}}
      .dump(-1, ' ', false, json::error_handler_t::replace);
}

}  // namespace holdfast::dashboard
