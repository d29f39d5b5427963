// SPDX-License-Identifier: Apache-2.0
#include "tests/safety/gate_enumeration.hpp"

#include <algorithm>
#include <deque>
#include <sstream>
#include <tuple>
#include <utility>

#include "tests/safety/good_inputs.hpp"

namespace holdfast::safety::test {
namespace {

constexpr int kAgeCap = 6;  // beyond confirm_max, hold_max and every exposure's age
constexpr int kSeenCap =
    4;  // beyond every exposure's age and hold_recovery, one tick back included
constexpr int kNever = -9;
constexpr Timestamp kNow = std::chrono::seconds(100);
constexpr std::uint32_t kStopId = 7;  // every state is moved to this id: ids only count
constexpr std::uint64_t kA = kRegistrationId, kB = kRegistrationId + 1;

/// One kind of wrongness of each way in which the gate treats reasons.
enum class Wrong : std::uint8_t {
  nothing,
  internal_fault,  ///< latches in every mode
  drift,           ///< a stop that latches in use only
  robot_fault,     ///< likewise, and no matter to the drift check
  no_frame,        ///< a hold; the camera has not delivered yet
  tracking_lost,   ///< a hold
  camera_event,    ///< a hold until a good frame comes after it
  optics_changed,  ///< a stop, and a doubt
  optics_unknown   ///< a hold, and a doubt
};
constexpr int kWrongCount = 9;

struct Step {
  int ticks = 1;  ///< since the cycle before; negative: time goes back
  Wrong wrong = Wrong::nothing;
  int registration = 1;  ///< 0 none, 1 A, 2 B
  bool is_frame_new = true;
  bool is_estimate_new = true;
  int exposed_before = 0;  ///< ticks; 0: exposed now
  Command command = Command::none;
  bool is_right_id = true;
};

/// B is there to be changed to: with it only the wrongs that decide on a verification.
bool is_worth_a_try(int registration, Wrong wrong) {
  return registration != 2 || wrong == Wrong::nothing || wrong == Wrong::optics_unknown;
}

std::vector<Step> all_steps() {
  std::vector<Step> steps;
  const auto commands = {std::pair{Command::none, true}, {Command::arm, true},
                         {Command::disarm, true},        {Command::stop, true},
                         {Command::acknowledge, true},   {Command::confirm, true},
                         {Command::acknowledge, false},  {Command::confirm, false}};
  // New frame, new estimate, ticks since exposure: a frame that comes late is enough once.
  const auto images = {
      std::tuple{true, true, 0}, {true, true, 2}, {true, false, 0}, {false, true, 0}};
  for (const int ticks : {1, 3, -1})
    for (int wrong = 0; wrong < kWrongCount; ++wrong)
      for (const int registration : {0, 1, 2})
        for (const auto& [is_frame_new, is_estimate_new, exposed_before] : images)
          for (const auto& [command, is_right_id] : commands)
            if (is_worth_a_try(registration, static_cast<Wrong>(wrong)))
              steps.push_back({ticks, static_cast<Wrong>(wrong), registration, is_frame_new,
                               is_estimate_new, exposed_before, command, is_right_id});
  return steps;
}

Inputs inputs_of(const Step& step, const GateState& state) {
  Inputs in = good_inputs(kNow);
  in.camera.t_last_frame_received = step.is_frame_new ? kNow : kNow - 3 * kTick;
  in.tracking.is_new = step.is_estimate_new;
  in.tracking.t_exposure = kNow - step.exposed_before * kTick;
  in.registration.is_loaded = step.registration != 0;
  in.registration.id = in.tracking.registration_id = step.registration == 2 ? kB : kA;
  in.operator_command = {step.command, step.is_right_id ? state.stop_id : state.stop_id + 1};
  switch (step.wrong) {
    case Wrong::nothing:
      break;
    case Wrong::internal_fault:
      in.loop.internal_fault = true;
      break;
    case Wrong::drift:
      in.tracking.drift_mm = 1;
      break;
    case Wrong::robot_fault:
      in.robot.has_fault = true;
      break;
    case Wrong::no_frame:
      in.camera.has_frame = false;
      break;
    case Wrong::tracking_lost:
      in.tracking.is_lost = true;
      break;
    case Wrong::camera_event:
      in.camera.faults.insert(Reason::frame_dark);
      break;
    case Wrong::optics_changed:
      in.optics.zoom += 0.01;
      break;
    case Wrong::optics_unknown:
      in.optics.is_known = false;
      break;
  }
  return in;
}

/// All times moved so that the newest cycle was `ticks` before kNow.
void move(Timestamp& t, Duration by) {
  if (t != Timestamp{}) t += by;
}
void move(GateState& state, Duration by) {
  for (Timestamp* t : {&state.t_mode_entered, &state.t_last_cycle, &state.t_acknowledged,
                       &state.t_hold_entered, &state.t_well_since, &state.t_frame_at_fault,
                       &state.t_registration_seen, &state.t_optics_doubted})
    move(*t, by);
}

/// Ticks before the newest cycle, capped; negative: in the future, since time went back.
int age(Timestamp t, const GateState& state, int cap = kAgeCap) {
  if (t == Timestamp{}) return kNever;
  return static_cast<int>(std::min<Duration::rep>((state.t_last_cycle - t) / kTick, cap));
}

using Key = std::vector<int>;

/// What of a state can matter to what follows. That the rest cannot is not taken on trust: see
/// Explorer::compare().
Key key_of(const GateState& s, const Observer& o) {
  const auto observed = [](const std::optional<int>& ticks) { return ticks.value_or(kNever); };
  const bool is_stopped = s.mode == Mode::stop_latched;
  return {static_cast<int>(s.mode),
          s.mode == Mode::hold ? age(s.t_hold_entered, s) : 0,
          s.mode == Mode::hold ? age(s.t_well_since, s, kSeenCap) : 0,
          is_stopped && s.is_acknowledged ? age(s.t_acknowledged, s) : kNever,
          s.is_awaiting_good_frame ? age(s.t_frame_at_fault, s, 5) : kNever,
          s.has_registration ? (s.registration_id == kA ? 1 : 2) : 0,
          s.is_keyframe_verified ? 1 : 0,
          age(s.t_registration_seen, s, kSeenCap),
          age(s.t_optics_doubted, s, kSeenCap),
          s.has_cycle ? 1 : 0,
          static_cast<int>(o.mode),
          observed(o.acknowledged),
          observed(o.hold_entered),
          std::min(observed(o.unwell), kSeenCap),
          std::min(observed(o.doubted), kSeenCap),
          std::min(observed(o.registered), kSeenCap),
          o.is_verified ? 1 : 0};
}

std::string text_of(const Step& s) {
  std::ostringstream text;
  text << s.ticks << " ticks, wrong " << static_cast<int>(s.wrong) << ", registration "
       << s.registration << (s.is_frame_new ? ", new frame" : ", old frame")
       << (s.is_estimate_new ? ", new estimate" : ", old estimate") << " exposed "
       << s.exposed_before << " ticks before, command " << static_cast<int>(s.command)
       << (s.is_right_id ? "" : " with a wrong id");
  return text.str();
}

void grow(std::optional<int>& ticks, int by) {
  if (ticks) ticks = std::min(*ticks + by, kAgeCap);
}

struct State {
  GateState gate;
  Observer observer;
  std::uint64_t registration = 0;  ///< as the observer saw it last; 0: none
  bool has_gone_back = false;      ///< time has, and the stop that it made is not ended yet
};

class Explorer {
 public:
  explicit Explorer(Decide decide) : decide_(decide), steps_(all_steps()) {}

  Enumeration run() {
    result_.inputs = steps_.size();
    State first;
    add(first);
    while (!open_.empty() && result_.violation.empty()) {
      const State state = open_.front();
      open_.pop_front();
      for (const Step& step : steps_) {
        if (state.has_gone_back && step.ticks < 0) continue;  // once in a stop
        State next = state;
        const Decision decision = apply(step, next);
        ++result_.transitions;
        ++result_.mode_changes[{state.gate.mode, next.gate.mode}];
        judge(step, state, next, decision);
        if (!result_.violation.empty()) {
          result_.violation += " (" + std::string(name(state.gate.mode)) + " to " +
                               std::string(name(next.gate.mode)) + " on: " + text_of(step) + ")";
          break;
        }
        add(next);
      }
    }
    result_.states = seen_.size();
    return result_;
  }

 private:
  Decision apply(const Step& step, State& state) const {
    move(state.gate, (kNow - step.ticks * kTick) - state.gate.t_last_cycle);
    if (state.gate.stop_id != 0) state.gate.stop_id = kStopId;
    const Inputs in = inputs_of(step, state.gate);
    return decide_(limits_, in, state.gate);
  }

  void add(const State& state) {
    Key key = key_of(state.gate, state.observer);
    key.push_back(state.has_gone_back ? 1 : 0);
    const auto [at, is_new] = seen_.emplace(std::move(key), state);
    if (is_new)
      open_.push_back(state);
    else if (++merged_ % 97 == 0)
      compare(state, at->second);
  }

  /// Two states that were taken for one: some inputs must lead both to the same decision and again
  /// to states that are taken for one.
  void compare(const State& one, const State& other) {
    ++result_.merged_and_compared;
    for (std::size_t i = merged_ % 31; i < steps_.size(); i += 331) {
      if (steps_[i].ticks < 0) continue;  // a tick back takes capped ages apart, by that tick
      State a = one, b = other;
      const Decision x = apply(steps_[i], a);
      const Decision y = apply(steps_[i], b);
      const Observer nobody;
      if (x.mode != y.mode || x.reasons != y.reasons ||
          x.approved.has_value() != y.approved.has_value() ||
          key_of(a.gate, nobody) != key_of(b.gate, nobody))
        result_.violation = "two states that were taken for one behave differently";
    }
  }

  void require(bool holds, const char* what) {
    if (!holds && result_.violation.empty()) result_.violation = what;
  }

  /// What may be, from inputs and earlier decisions alone. `next.observer` is brought up to date.
  void judge(const Step& step, const State& before, State& next, const Decision& decision) {
    Observer o = before.observer;
    for (auto* ticks : {&o.acknowledged, &o.hold_entered, &o.unwell, &o.doubted, &o.registered})
      grow(*ticks, step.ticks);
    // Without a registration there is nothing to hold the zoom against.
    const bool is_zoomed = step.wrong == Wrong::optics_changed && step.registration != 0;
    const bool is_optics = is_zoomed || step.wrong == Wrong::optics_unknown;
    const std::uint64_t registration = step.registration == 0   ? 0
                                       : step.registration == 1 ? kA
                                                                : kB;
    const bool is_same = registration != 0 && registration == before.registration;
    const bool is_changed = o.is_verified && !is_same;
    if (!is_same) {
      o.is_verified = false;
      o.registered = 0;
    }
    if (is_optics) o.doubted = 0;
    if (is_optics && o.mode == Mode::ready) o.is_verified = false;
    const bool is_backwards = step.ticks < 0 && o.has_cycle;
    const bool is_stop = step.command == Command::stop || is_backwards || is_changed ||
                         step.wrong == Wrong::internal_fault || step.wrong == Wrong::drift ||
                         step.wrong == Wrong::robot_fault || is_zoomed;
    const bool is_hold = step.wrong == Wrong::no_frame || step.wrong == Wrong::tracking_lost ||
                         step.wrong == Wrong::camera_event || step.wrong == Wrong::optics_unknown;
    const bool is_fault = is_stop || is_hold;
    if (is_fault) o.unwell = 0;

    require(decision.approved.has_value() == (decision.mode == Mode::permitted),
            "a pose without the mode, or the mode without a pose");
    require((decision.cause == Reason::none) == (decision.mode == Mode::permitted),
            "a refusal without a cause");
    if (decision.mode == Mode::permitted) {
      require(!is_fault, "permitted with a fault");
      require(registration != 0 && o.is_verified, "permitted without a verified registration");
      const bool is_armed = o.mode == Mode::ready && step.command == Command::arm &&
                            (!o.doubted || step.exposed_before < *o.doubted);
      const bool is_recovered = o.mode == Mode::hold && o.unwell && *o.unwell >= 2 &&
                                o.hold_entered && *o.hold_entered <= 4;
      require(o.mode == Mode::permitted || is_armed || is_recovered,
              "permitted neither by arming nor by recovery");
    }
    if (o.mode == Mode::permitted || o.mode == Mode::hold) {
      require(!is_stop || decision.mode == Mode::stop_latched, "a stop that does not latch in use");
      require(o.mode != Mode::permitted || !is_hold || decision.mode == Mode::hold ||
                  decision.mode == Mode::stop_latched || step.command == Command::disarm,
              "a hold reason that does not hold");
      const bool is_overdue = o.mode == Mode::hold && *o.hold_entered > 4;
      require(!is_overdue || decision.mode == Mode::stop_latched, "a hold that outlasts its limit");
    }
    if (step.command == Command::stop || step.wrong == Wrong::internal_fault || is_backwards)
      require(decision.mode == Mode::stop_latched, "a stop that does not latch in every mode");
    if (o.mode == Mode::stop_latched && decision.mode != Mode::stop_latched) {
      require(decision.mode == Mode::ready, "a stop that ends elsewhere than in ready");
      require(step.command == Command::confirm && step.is_right_id, "a stop ended unconfirmed");
      require(o.acknowledged && *o.acknowledged >= 2 && *o.acknowledged <= 4,
              "a stop ended without its first step, or too early, or too late");
      require(!is_fault && registration != 0, "a stop ended with a fault");
      require(o.acknowledged && step.exposed_before < *o.acknowledged,
              "a stop ended on an image from before the acknowledgement");
      require(!o.doubted || step.exposed_before < *o.doubted,
              "a stop ended on an image from before a doubt about the optics");
    }
    observe(step, is_stop, decision, o);
    next.observer = o;
    next.registration = registration;
    next.has_gone_back =
        decision.mode == Mode::stop_latched && (before.has_gone_back || is_backwards);
  }

  static void observe(const Step& step, bool is_stop, const Decision& decision, Observer& o) {
    const bool is_verified_now = decision.mode == Mode::ready &&
                                 (o.mode == Mode::unregistered || o.mode == Mode::stop_latched);
    if (is_verified_now) {
      // Only a drift check that passes on an image of this registration and these optics may do it.
      const bool is_recent = (!o.registered || step.exposed_before < *o.registered) &&
                             (!o.doubted || step.exposed_before < *o.doubted);
      o.is_verified = is_recent && step.registration != 0;
    }
    if (step.command == Command::acknowledge && o.mode == Mode::stop_latched && !is_stop)
      o.acknowledged = step.is_right_id ? std::optional(0) : std::nullopt;
    if (step.command == Command::confirm || is_stop || decision.mode != Mode::stop_latched)
      o.acknowledged.reset();
    if (decision.mode == Mode::hold && o.mode != Mode::hold) o.hold_entered = 0;
    if (decision.mode != Mode::hold) o.hold_entered.reset();
    if (decision.mode != Mode::hold) o.unwell.reset();
    o.mode = decision.mode;
    o.has_cycle = true;
  }

  Decide decide_;
  Limits limits_ = small_limits();
  std::vector<Step> steps_;
  std::map<Key, State> seen_;
  std::deque<State> open_;
  std::size_t merged_ = 0;
  Enumeration result_;
};

}  // namespace

Limits small_limits() {
  Limits limits;
  limits.frame_period = limits.estimate_age_max = limits.robot_silence_max =
      std::chrono::seconds(1);
  limits.hold_recovery = 2 * kTick;
  limits.hold_max = 4 * kTick;
  limits.confirm_min = 2 * kTick;
  limits.confirm_max = 4 * kTick;
  return limits;
}

Enumeration enumerate(Decide decide) {
  return Explorer(decide).run();
}

}  // namespace holdfast::safety::test
