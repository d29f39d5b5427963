// SPDX-License-Identifier: Apache-2.0
#include "rt/observer/observed_state.hpp"

#include <algorithm>
#include <cmath>

#include "rt/reason_text.hpp"
#include "safety/gate.hpp"

namespace holdfast::observer {
namespace {

using bridge::dds::Clocks;
using safety::Mode;
using safety::Verdict;

/// A lost message is no reason not to look at the next: what is shown decides nothing.
constexpr std::uint32_t kAnyStep = 0x7fff'ffff;

safety::ReceiverParameters receiver_parameters(const ObserverParameters& parameters,
                                               nanoseconds validity) {
  safety::ReceiverParameters result;
  result.clock = parameters.clock;
  result.max_counter_step = kAnyStep;
  result.max_validity = validity;
  return result;
}

constexpr std::string_view kStop = "STOP", kNotPermitted = "NOT PERMITTED";

/// A daemon's message whose parts contradict each other shows no permission.
bool says_permitted(const msg::MotionStop& m) noexcept {
  return m.is_permitted && m.mode == static_cast<std::uint8_t>(Mode::permitted) && m.cause == 0 &&
         !m.is_latched;
}

Shown of_daemon(const msg::MotionStop& m) noexcept {
  const auto cause = static_cast<safety::Reason>(m.cause);
  const auto mode = static_cast<Mode>(m.mode);
  Shown shown{Level::stop, kStop, safety::name(cause), rt::sentence(cause)};
  if (m.is_permitted || m.cause == 0 || mode == Mode::permitted) {
    shown.reason = "message_contradicts_itself";
    shown.text = "The daemon's message contradicts itself";
  } else if (mode == Mode::hold) {
    shown.level = Level::hold;
    shown.word = "HOLD";
  } else if (mode == Mode::ready || mode == Mode::init || mode == Mode::unregistered) {
    shown.level = Level::not_ready;
    shown.word = kNotPermitted;
  }
  return shown;
}

Shown of_guard(const msg::GuardPermission& m, std::uint32_t daemon_source) noexcept {
  const auto cause = static_cast<guard::GuardCause>(m.cause);
  Shown shown{Level::hold, kNotPermitted, guard::name(cause), rt::sentence(cause), true};
  if (m.is_permitted && m.daemon_source != daemon_source) {
    shown.reason = "another_daemon";
    shown.text = "The guard vouches for another daemon";
  } else if (m.is_permitted || m.cause == 0) {
    shown.reason = "message_contradicts_itself";
    shown.text = "The guard's message contradicts itself";
  }
  return shown;
}

}  // namespace

std::string_view name(Level level) noexcept {
  switch (level) {
    case Level::no_data:
      return "no_data";
    case Level::stop:
      return "stop";
    case Level::hold:
      return "hold";
    case Level::not_ready:
      return "not_ready";
    case Level::permitted:
      return "permitted";
  }
  return "no_data";
}

void Histogram::record(nanoseconds value) noexcept {
  const auto ms = std::max<std::int64_t>(0, value.count()) / 1'000'000;
  counts[std::min(static_cast<std::size_t>(ms), kBins - 1)] += 1;
  ++count;
  max = std::max(max, value);
}

double Histogram::percentile_ms(double share) const noexcept {
  const auto wanted = static_cast<std::uint64_t>(std::ceil(share * static_cast<double>(count)));
  std::uint64_t seen = 0;
  for (std::size_t bin = 0; bin + 1 < kBins; ++bin) {
    seen += counts[bin];
    if (count > 0 && seen >= wanted) return static_cast<double>(bin + 1);
  }
  return std::chrono::duration<double, std::milli>(max).count();
}

template <class M>
ObservedState::Stream<M>::Stream(const ObserverParameters& parameters, nanoseconds silence)
    : receiver(bridge::dds::Topic<M>::policy().data_id,
               receiver_parameters(parameters, bridge::dds::Topic<M>::policy().validity)),
      silence_max(silence) {}

ObservedState::ObservedState(const ObserverParameters& parameters)
    : parameters_(parameters),
      stop_(parameters, parameters.silence_max),
      guard_(parameters, parameters.silence_max),
      health_(parameters, parameters.health_silence_max),
      registration_(parameters, nanoseconds::max()),
      robot_(parameters, parameters.robot_silence_max),
      pose_(parameters, parameters.silence_max) {}

template <class M>
bool ObservedState::accept(Stream<M>& stream, const M& message, Clocks now) {
  const Verdict verdict = bridge::dds::check(message, stream.receiver, now);
  // A registration is announced once: that it is hours old does not make it another's.
  const bool is_accepted = verdict == Verdict::accepted ||
                           (std::same_as<M, msg::RegistrationInfo> && verdict == Verdict::expired);
  if (!is_accepted) {
    ++refused_;
    return false;
  }
  stream.newest = message;
  stream.t_received = now.monotonic;
  stream.has = true;
  return true;
}

void ObservedState::take(const msg::MotionStop& message, Clocks now) {
  if (accept(stop_, message, now)) pass(now);
}
void ObservedState::take(const msg::GuardPermission& message, Clocks now) {
  if (accept(guard_, message, now)) pass(now);
}
void ObservedState::take(const msg::RegistrationInfo& message, Clocks now) {
  (void)accept(registration_, message, now);
}
void ObservedState::take(const msg::RobotStatus& message, Clocks now) {
  (void)accept(robot_, message, now);
}

void ObservedState::take(const msg::TrackingHealth& message, Clocks now) {
  if (!accept(health_, message, now) || message.frame == frame_of_health_) return;
  frame_of_health_ = message.frame;
  tracker_.record(std::chrono::microseconds(message.tracker_us));
}

void ObservedState::take(const msg::CompensatedPose& message, Clocks now) {
  if (!accept(pose_, message, now) || message.frame == frame_of_pose_) return;
  frame_of_pose_ = message.frame;
  exposure_to_pose_.record(nanoseconds(message.protection.t_monotonic_ns - message.t_exposure_ns));
}

void ObservedState::pass(Clocks now) {
  const Shown seen = shown(now.monotonic);
  const msg::MotionStop* d = daemon(now.monotonic);
  const std::uint32_t stop_id = d != nullptr && d->is_latched ? d->stop_id : 0;
  const bool is_permitted = seen.level == Level::permitted;
  const bool is_event = !is_permitted && (was_permitted_ || (stop_id != 0 && stop_id != stop_id_));
  if ((is_permitted || is_event) && !stop_events_.empty() && !stop_events_.back().duration)
    stop_events_.back().duration = now.monotonic - t_event_;
  if (is_event) {
    stop_events_.push_back(
        {now.utc.count(), seen, d != nullptr ? d->reasons : 0, stop_id, std::nullopt});
    t_event_ = now.monotonic;
    if (stop_events_.size() > kStopsKept) stop_events_.pop_front();
  }
  if (stop_id != 0) stop_id_ = stop_id;
  was_permitted_ = is_permitted;
}

Shown ObservedState::shown(nanoseconds now) const noexcept {
  const msg::MotionStop* d = daemon(now);
  if (d == nullptr)
    return {Level::no_data, "STOP: NO DATA", "daemon_silent", "Nothing is heard from the daemon"};
  if (!says_permitted(*d)) return of_daemon(*d);
  if (parameters_.has_guard) {
    const msg::GuardPermission* g = guard(now);
    if (g == nullptr)
      return {Level::no_data, "STOP: NO DATA", "guard_silent", "Nothing is heard from the guard",
              true};
    if (!g->is_permitted || g->cause != 0 || g->daemon_source != d->protection.source)
      return of_guard(*g, d->protection.source);
  }
  return {Level::permitted, "PERMITTED", "none", "Motion is permitted"};
}

const msg::MotionStop* ObservedState::daemon(nanoseconds now) const noexcept {
  return stop_.fresh(now);
}
const msg::GuardPermission* ObservedState::guard(nanoseconds now) const noexcept {
  return guard_.fresh(now);
}
const msg::TrackingHealth* ObservedState::health(nanoseconds now) const noexcept {
  return health_.fresh(now);
}
const msg::RobotStatus* ObservedState::robot(nanoseconds now) const noexcept {
  return robot_.fresh(now);
}

const msg::CompensatedPose* ObservedState::pose(nanoseconds now) const noexcept {
  const msg::MotionStop* d = daemon(now);
  const msg::CompensatedPose* p = pose_.fresh(now);
  const bool belongs = p != nullptr && d != nullptr &&
                       p->protection.source == d->protection.source &&
                       p->protection.t_monotonic_ns >= d->t_changed_ns;
  return belongs && shown(now).level == Level::permitted ? p : nullptr;
}

const msg::RegistrationInfo* ObservedState::registration(nanoseconds now) const noexcept {
  const msg::TrackingHealth* h = health(now);
  const bool is_confirmed = registration_.has && registration_.newest.is_loaded && h != nullptr &&
                            h->registration_id == registration_.newest.registration_id;
  return is_confirmed ? &registration_.newest : nullptr;
}

}  // namespace holdfast::observer
