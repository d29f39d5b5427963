// SPDX-License-Identifier: Apache-2.0
#include "bridge/client/permission.hpp"

#include <algorithm>
#include <cmath>

namespace holdfast::client {
namespace {

using std::chrono::nanoseconds;

// safety/gate.hpp Mode::permitted. Not included here: it would make robots depend on Eigen.
constexpr std::uint8_t kModePermitted = 3;
constexpr std::uint8_t kModeStopLatched = 5;

constexpr double kRotationTolerance = 1e-6;    // of the quaternion's norm
constexpr double kCovarianceTolerance = 1e-9;  // of symmetry, mm², mm·rad, rad²

safety::ReceiverParameters receiver_parameters(const Parameters& p) noexcept {
  safety::ReceiverParameters result;
  result.clock = p.clock == ClockRelation::same_host ? safety::ClockRelation::same_host
                                                     : safety::ClockRelation::synchronised_utc;
  result.max_counter_step = 1;
  result.future_tolerance = p.future_tolerance;
  result.max_validity = p.validity_max;
  return result;
}

Refusal refusal_of(safety::Verdict verdict, std::uint32_t source) noexcept {
  using safety::Verdict;
  switch (verdict) {
    case Verdict::accepted:
      return Refusal::none;
    case Verdict::bad_version:
      return Refusal::bad_version;
    case Verdict::bad_data_id:
      return Refusal::bad_data_id;
    case Verdict::bad_source:
      return source == 0 ? Refusal::no_source : Refusal::second_source;
    case Verdict::bad_crc:
      return Refusal::bad_crc;
    case Verdict::repeated:
      return Refusal::repeated;
    case Verdict::skipped:
      return Refusal::skipped;
    case Verdict::expired:
      return Refusal::expired;
    case Verdict::from_future:
      return Refusal::from_future;
    case Verdict::time_reversed:
      return Refusal::time_reversed;
  }
  return Refusal::bad_version;
}

template <std::size_t N>
bool all_finite(const double (&values)[N]) noexcept {
  return std::ranges::all_of(values, [](double v) { return std::isfinite(v); });
}

bool is_unit(const double (&q)[4]) noexcept {
  const double norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  return std::abs(norm - 1) <= kRotationTolerance;
}

bool is_covariance(const double (&c)[36]) noexcept {
  for (std::size_t row = 0; row < 6; ++row) {
    if (!(c[7 * row] > 0)) return false;
    for (std::size_t column = 0; column < row; ++column)
      if (!(std::abs(c[6 * row + column] - c[6 * column + row]) <= kCovarianceTolerance))
        return false;
  }
  return true;
}

// What a motion-stop message says three times over must agree.
bool is_contradictory(const msg::MotionStop& m) noexcept {
  const bool is_permitted = m.is_permitted;
  return is_permitted != (m.mode == kModePermitted) || is_permitted != (m.cause == 0) ||
         m.is_latched != (m.mode == kModeStopLatched);
}

}  // namespace

PermissionCore::PermissionCore(const Parameters& parameters) noexcept
    : parameters_(parameters),
      stops_{.receiver = {safety::DataId::motion_stop, receiver_parameters(parameters)},
             .fault = Refusal::no_stop_message},
      poses_{.receiver = {safety::DataId::compensated_pose, receiver_parameters(parameters)},
             .fault = Refusal::no_pose},
      guards_{.receiver = {safety::DataId::guard_permission, receiver_parameters(parameters)},
              .fault = Refusal::no_guard_message} {}

template <class M>
Refusal PermissionCore::examine(const M& message, Stream& stream, Clocks now) noexcept {
  const auto verdict = bridge::dds::check(message, stream.receiver, now);
  const auto refusal = refusal_of(verdict, message.protection.source);
  if (refusal == Refusal::second_source) {
    has_second_source_ = true;
    t_second_source_ = now.monotonic;
  }
  return refusal;
}

// Counts one message for or against its stream. True when the message may be used.
bool PermissionCore::settle(Stream& stream, Refusal refusal, std::uint32_t source,
                            std::uint64_t& accepted, std::uint64_t& refused) noexcept {
  if (refusal != Refusal::none) {
    ++refused;
    ++counts_.refused_messages[static_cast<std::size_t>(refusal)];
    newest_refusal_ = refusal;
    stream.fault = refusal;
    stream.good_messages = 0;
    return false;
  }
  ++accepted;
  if (source != stream.source && stream.source != 0) {  // a new sender starts from nothing
    stream.good_messages = 0;
    stream.fault = Refusal::second_source;
  }
  stream.source = source;
  if (++stream.good_messages >= parameters_.recovery_messages) {
    stream.good_messages = parameters_.recovery_messages;
    stream.fault = Refusal::none;
  }
  return true;
}

std::int64_t PermissionCore::to_local(std::int64_t t_ns, const msg::Protection& protection,
                                      Clocks now) const noexcept {
  if (parameters_.clock == ClockRelation::same_host) return t_ns;
  // The sender's stamp pair takes its monotonic time to UTC, ours takes UTC to our monotonic time.
  return protection.t_utc_ns + (t_ns - protection.t_monotonic_ns) +
         (now.monotonic - now.utc).count();
}

Refusal PermissionCore::content_fault(const msg::CompensatedPose& m) const noexcept {
  if (!all_finite(m.translation_mm) || !all_finite(m.rotation_xyzw) || !all_finite(m.covariance) ||
      !all_finite(m.target_robot_mm))
    return Refusal::invalid_number;
  if (!is_unit(m.rotation_xyzw)) return Refusal::invalid_rotation;
  if (!is_covariance(m.covariance)) return Refusal::invalid_covariance;
  // None is negative, so that no difference can overflow.
  const std::int64_t t_sent = m.protection.t_monotonic_ns;
  if (t_sent < 0 || m.t_pose_ns < 0 || m.t_exposure_ns < 0 || m.t_frame_received_ns < 0)
    return Refusal::invalid_time;
  const nanoseconds lead(m.t_pose_ns - t_sent);
  const nanoseconds extrapolation(m.t_pose_ns - m.t_exposure_ns);
  if (lead > parameters_.pose_lead_max || lead < -parameters_.pose_lead_max ||
      extrapolation > parameters_.extrapolation_max || m.t_exposure_ns > t_sent ||
      m.t_frame_received_ns > t_sent)
    return Refusal::invalid_time;
  return Refusal::none;
}

void PermissionCore::take(const msg::MotionStop& m, Clocks now) noexcept {
  auto refusal = examine(m, stops_, now);
  if (refusal == Refusal::none && is_contradictory(m)) refusal = Refusal::contradictory_stop;
  if (!settle(stops_, refusal, m.protection.source, counts_.stops_accepted, counts_.stops_refused))
    return;
  stop_ = {.is_permitted = m.is_permitted,
           .is_latched = m.is_latched,
           .mode = m.mode,
           .cause = m.cause,
           .stop_id = m.stop_id,
           .reasons = m.reasons,
           .counter = m.protection.counter,
           .t_changed_ns = m.t_changed_ns,
           .t_evidence_ns = m.t_evidence_ns,
           .t_sent_ns = m.protection.t_monotonic_ns,
           .t_received_ns = now.monotonic.count()};
}

void PermissionCore::take(const msg::CompensatedPose& m, Clocks now) noexcept {
  auto refusal = examine(m, poses_, now);
  if (refusal == Refusal::none) refusal = content_fault(m);
  if (!settle(poses_, refusal, m.protection.source, counts_.poses_accepted, counts_.poses_refused))
    return;
  const nanoseconds validity = std::min<nanoseconds>(
      std::chrono::microseconds(m.protection.validity_us), parameters_.validity_max);
  pose_.t_pose_ns = to_local(m.t_pose_ns, m.protection, now);
  // Neither the message nor the prediction in it may be older than the validity.
  pose_.t_valid_until_ns =
      std::min(poses_.receiver.valid_until().count(), pose_.t_pose_ns + validity.count());
  pose_.t_exposure_ns = m.t_exposure_ns;
  pose_.t_frame_received_ns = m.t_frame_received_ns;
  pose_.frame = m.frame;
  pose_.registration_id = m.registration_id;
  pose_.counter = m.protection.counter;
  std::ranges::copy(m.translation_mm, pose_.translation_mm.begin());
  std::ranges::copy(m.rotation_xyzw, pose_.rotation_xyzw.begin());
  std::ranges::copy(m.covariance, pose_.covariance.begin());
  std::ranges::copy(m.target_robot_mm, pose_.target_robot_mm.begin());
  t_pose_sent_ns_ = m.protection.t_monotonic_ns;
}

void PermissionCore::take(const msg::GuardPermission& m, Clocks now) noexcept {
  auto refusal = examine(m, guards_, now);
  if (refusal == Refusal::none && m.is_permitted != (m.cause == 0))
    refusal = Refusal::contradictory_stop;
  if (!settle(guards_, refusal, m.protection.source, counts_.guards_accepted,
              counts_.guards_refused))
    return;
  is_vouched_ = m.is_permitted;
  guard_cause_ = m.cause;
  vouched_source_ = m.daemon_source;
  t_vouched_ns_ = m.t_changed_ns;
}

Refusal PermissionCore::guard_refusal_at(nanoseconds now) const noexcept {
  if (parameters_.guard == Guard::absent) return Refusal::none;
  if (guards_.fault != Refusal::none) return guards_.fault;
  if (now > guards_.receiver.valid_until()) return Refusal::guard_silent;
  if (!is_vouched_) return Refusal::guard_withheld;
  if (vouched_source_ != poses_.source) return Refusal::sources_differ;
  if (t_pose_sent_ns_ < t_vouched_ns_) return Refusal::pose_before_permission;
  return Refusal::none;
}

Refusal PermissionCore::refusal_at(nanoseconds now) const noexcept {
  if (has_second_source_ && now - t_second_source_ < parameters_.second_source_hold)
    return Refusal::second_source;
  if (stops_.fault != Refusal::none) return stops_.fault;
  if (now > stops_.receiver.valid_until()) return Refusal::stop_silent;
  if (!stop_.is_permitted) return Refusal::not_permitted;
  if (poses_.fault != Refusal::none) return poses_.fault;
  if (now.count() > pose_.t_valid_until_ns) return Refusal::pose_silent;
  if (poses_.source != stops_.source) return Refusal::sources_differ;
  if (t_pose_sent_ns_ < stop_.t_changed_ns) return Refusal::pose_before_permission;
  return guard_refusal_at(now);
}

Permission PermissionCore::decide(nanoseconds now) const noexcept {
  Permission permission;
  permission.t_ns = now.count();
  permission.stop = stop_;
  permission.guard_cause = guard_cause_;
  permission.refusal = refusal_at(now);
  if (permission.refusal != Refusal::none) return permission;
  permission.pose = pose_;
  permission.pose->t_valid_until_ns =
      std::min(pose_.t_valid_until_ns, stops_.receiver.valid_until().count());
  if (parameters_.guard == Guard::required)
    permission.pose->t_valid_until_ns =
        std::min(permission.pose->t_valid_until_ns, guards_.receiver.valid_until().count());
  return permission;
}

}  // namespace holdfast::client
