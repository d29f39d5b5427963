// SPDX-License-Identifier: Apache-2.0
#include "rt/observer/observed_state.hpp"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "rt/dashboard/snapshot.hpp"
#include "rt/reason_text.hpp"
#include "safety/gate.hpp"
#include "tests/rt/observed_room.hpp"

namespace holdfast::observer {
namespace {

using bridge::dds::Clocks;
using dashboard::history_json;
using dashboard::state_json;
using namespace std::chrono_literals;

/// Daemon and guard in virtual time; a test spoils one thing.
class ObservedStateTest : public ObservedRoom {
 protected:
  static msg::MotionStop permitted() {
    msg::MotionStop m{};
    m.mode = static_cast<std::uint8_t>(safety::Mode::permitted);
    m.is_permitted = true;
    return m;
  }
  static msg::MotionStop withdrawn(safety::Mode mode, safety::Reason cause) {
    msg::MotionStop m{};
    m.mode = static_cast<std::uint8_t>(mode);
    m.cause = static_cast<std::uint8_t>(cause);
    m.reasons = std::uint64_t{1} << m.cause;
    m.is_latched = mode == safety::Mode::stop_latched;
    m.stop_id = m.is_latched ? 4 : 0;
    return m;
  }
  static msg::GuardPermission vouched(bool is_permitted = true, std::uint8_t cause = 0) {
    msg::GuardPermission m{};
    m.is_permitted = is_permitted;
    m.cause = cause;
    m.daemon_source = kDaemon;
    return m;
  }
  void permit() {
    send(permitted());
    send(vouched(), kGuard);
  }
  Shown after(nanoseconds duration) {
    now_ += duration;
    state_.pass(clocks());
    return state_.shown(now_);
  }
  Level level() { return after(0ns).level; }
};

TEST_F(ObservedStateTest, ShowsNoDataBeforeAnythingIsHeard) {
  RecordProperty("requirement", "SR-130");
  const Shown shown = after(0ns);
  EXPECT_EQ(shown.level, Level::no_data);
  EXPECT_EQ(shown.word, "STOP: NO DATA");
}

TEST_F(ObservedStateTest, ShowsPermittedOnlyWhenDaemonAndGuardSaySo) {
  RecordProperty("requirement", "SR-130");
  send(permitted());
  EXPECT_EQ(level(), Level::no_data) << "no guard";
  send(vouched(), kGuard);
  EXPECT_EQ(level(), Level::permitted);
  send(vouched(false, 9), kGuard);
  EXPECT_EQ(level(), Level::hold);
  EXPECT_EQ(state_.shown(now_).reason, "robot_silent");
  EXPECT_TRUE(state_.shown(now_).is_of_guard);
}

TEST_F(ObservedStateTest, TurnsSilenceOfEitherIntoNoDataWithinItsTime) {
  RecordProperty("requirement", "SR-130");
  permit();
  EXPECT_EQ(after(100ms).level, Level::permitted);
  EXPECT_EQ(after(1ns).level, Level::no_data) << "both are silent";
  EXPECT_EQ(state_.shown(now_).reason, "daemon_silent");
  EXPECT_EQ(state_.daemon(now_), nullptr);
  send(permitted());
  EXPECT_EQ(state_.shown(now_).reason, "guard_silent");
  send(vouched(), kGuard);
  EXPECT_EQ(level(), Level::permitted) << "it returns";
}

TEST_F(ObservedStateTest, NeverShowsPermissionForAMessageThatFailsItsCheck) {
  RecordProperty("requirement", "SR-130");
  msg::MotionStop bad = permitted();
  bridge::dds::protect(bad, kDaemon, ++counter_, 20ms, clocks());
  bad.t_changed_ns ^= 1;
  state_.take(bad, clocks());
  send(vouched(), kGuard);
  EXPECT_EQ(level(), Level::no_data);
  EXPECT_EQ(state_.refused(), 1U);

  msg::MotionStop old = permitted();
  bridge::dds::protect(old, kDaemon, ++counter_, 20ms, {now_ - 21ms, clocks().utc - 21ms});
  state_.take(old, clocks());
  EXPECT_EQ(level(), Level::no_data) << "sent 21 ms ago";
}

TEST_F(ObservedStateTest, ShowsAMessageThatContradictsItselfAsStop) {
  RecordProperty("requirement", "SR-130");
  msg::MotionStop m = permitted();
  m.cause = static_cast<std::uint8_t>(safety::Reason::drift_exceeded);
  msg::MotionStop latched = permitted();
  latched.is_latched = true;
  msg::MotionStop hold = permitted();
  hold.mode = static_cast<std::uint8_t>(safety::Mode::hold);
  msg::MotionStop unknown = permitted();
  unknown.mode = 77;
  msg::MotionStop denied = permitted();
  denied.is_permitted = false;
  for (const msg::MotionStop& contradiction : {m, latched, hold, unknown, denied}) {
    send(contradiction);
    send(vouched(), kGuard);
    EXPECT_EQ(level(), Level::stop);
    EXPECT_EQ(state_.shown(now_).reason, "message_contradicts_itself");
  }
}

TEST_F(ObservedStateTest, DoesNotBelieveAGuardThatVouchesForAnotherDaemon) {
  RecordProperty("requirement", "SR-130");
  send(permitted());
  msg::GuardPermission m = vouched();
  m.daemon_source = 99;
  send(m, kGuard);
  EXPECT_EQ(level(), Level::hold);
  EXPECT_EQ(state_.shown(now_).reason, "another_daemon");
  send(vouched(true, 3), kGuard);
  EXPECT_EQ(level(), Level::hold) << "permitted and a cause";
}

TEST_F(ObservedStateTest, NamesEachModeWithItsCause) {
  using safety::Mode;
  using safety::Reason;
  struct Case {
    Mode mode;
    Reason cause;
    Level level;
    std::string_view word;
  };
  for (const auto& [mode, cause, wanted, word] :
       {Case{Mode::init, Reason::initialising, Level::not_ready, "NOT PERMITTED"},
        Case{Mode::unregistered, Reason::not_registered, Level::not_ready, "NOT PERMITTED"},
        Case{Mode::ready, Reason::not_armed, Level::not_ready, "NOT PERMITTED"},
        Case{Mode::hold, Reason::frame_late, Level::hold, "HOLD"},
        Case{Mode::stop_latched, Reason::drift_exceeded, Level::stop, "STOP"}}) {
    send(withdrawn(mode, cause));
    const Shown shown = after(0ns);
    EXPECT_EQ(shown.level, wanted) << safety::name(cause);
    EXPECT_EQ(shown.word, word);
    EXPECT_EQ(shown.reason, safety::name(cause));
    EXPECT_EQ(shown.text, rt::sentence(cause));
  }
}

TEST_F(ObservedStateTest, GoesWithoutAGuardOnlyWhenTheSetUpDoes) {
  ObserverParameters parameters;
  parameters.has_guard = false;
  state_ = ObservedState(parameters);
  send(permitted());
  EXPECT_EQ(level(), Level::permitted);
}

TEST_F(ObservedStateTest, KeepsEachStopWithItsCauseAndDuration) {
  permit();
  send(withdrawn(safety::Mode::hold, safety::Reason::frame_late));
  now_ += 50ms;
  send(withdrawn(safety::Mode::stop_latched, safety::Reason::hold_timeout));
  now_ += 50ms;
  permit();
  (void)after(200ms);  // silence
  permit();
  ASSERT_EQ(state_.stops().size(), 3U);
  EXPECT_EQ(state_.stops()[0].shown.reason, "frame_late");
  EXPECT_EQ(*state_.stops()[0].duration, 50ms);
  EXPECT_EQ(state_.stops()[1].shown.reason, "hold_timeout");
  EXPECT_EQ(state_.stops()[1].stop_id, 4U);
  EXPECT_EQ(*state_.stops()[1].duration, 50ms);
  EXPECT_EQ(state_.stops()[2].shown.reason, "daemon_silent");
  for (std::size_t i = 0; i < 2 * ObservedState::kStopsKept; ++i) {
    permit();
    send(withdrawn(safety::Mode::hold, safety::Reason::frame_late));
  }
  EXPECT_EQ(state_.stops().size(), ObservedState::kStopsKept);
}

TEST_F(ObservedStateTest, ShowsARegistrationOnlyWhileTheHealthNamesIt) {
  msg::RegistrationInfo registration{};
  registration.is_loaded = true;
  registration.registration_id = 9;
  send(registration);
  EXPECT_EQ(state_.registration(now_), nullptr);
  msg::TrackingHealth health{};
  health.registration_id = 9;
  send(health);
  ASSERT_NE(state_.registration(now_), nullptr);
  health.registration_id = 10;
  send(health);
  EXPECT_EQ(state_.registration(now_), nullptr);
  health.registration_id = 9;
  send(health);
  (void)after(301ms);
  EXPECT_EQ(state_.registration(now_), nullptr) << "the health is silent";
}

TEST_F(ObservedStateTest, TakesARegistrationAnnouncedLongAgo) {
  msg::RegistrationInfo registration{};
  registration.is_loaded = true;
  registration.registration_id = 9;
  bridge::dds::protect(registration, kDaemon, ++counter_, 1h, {now_ - 2h, clocks().utc - 2h});
  now_ += 2h;
  state_.take(registration, clocks());
  msg::TrackingHealth health{};
  health.registration_id = 9;
  send(health);
  EXPECT_NE(state_.registration(now_), nullptr);
}

TEST_F(ObservedStateTest, WritesNoNumberWhereNoneIsKnown) {
  msg::TrackingHealth health{};
  health.status = 3;  // lost
  health.dx_um = 5;
  health.sigma_target_mm = std::numeric_limits<double>::quiet_NaN();
  send(health);
  const auto json = nlohmann::json::parse(state_json(state_, clocks()));
  EXPECT_EQ(json["tracking"]["status"], "lost");
  EXPECT_TRUE(json["tracking"]["dx_um"].is_null());
  EXPECT_TRUE(json["tracking"]["sigma_target_mm"].is_null());
  EXPECT_TRUE(json["daemon"].is_null());
  EXPECT_EQ(json["shown"]["level"], "no_data");
}

TEST_F(ObservedStateTest, PredictsTheErrorAtTheTargetFromTheRegistration) {
  msg::RegistrationInfo m{};
  m.is_loaded = true;
  m.registration_id = 1;
  m.rotation_xyzw[3] = 1;
  m.target_ct_mm[0] = 100;
  for (std::size_t i = 0; i < 3; ++i) m.covariance[7 * i] = 0.01;
  for (std::size_t i = 3; i < 6; ++i) m.covariance[7 * i] = 1e-6;  // 1 mrad: 0.1 mm at 100 mm
  send(m);
  msg::TrackingHealth health{};
  health.registration_id = 1;
  send(health);
  const auto json = nlohmann::json::parse(state_json(state_, clocks()));
  // Turning about y and z moves it, about x does not.
  EXPECT_NEAR(json["registration"]["predicted_tre_mm"], std::sqrt(3 * 0.01 + 2 * 0.01), 1e-12);
}

TEST_F(ObservedStateTest, CountsEachFramesLatencyOnce) {
  for (int frame = 1; frame <= 10; ++frame) {
    for (int i = 0; i < 3; ++i) {
      msg::CompensatedPose pose{};
      pose.frame = static_cast<std::uint64_t>(frame);
      pose.t_exposure_ns = (now_ - (frame < 10 ? 12'500us : 80'000us)).count();
      send(pose);
    }
  }
  const Histogram& h = state_.exposure_to_pose();
  EXPECT_EQ(h.count, 10U);
  EXPECT_EQ(h.counts[12], 9U);
  EXPECT_EQ(h.counts[Histogram::kBins - 1], 1U);
  EXPECT_EQ(h.percentile_ms(0.5), 13);
  EXPECT_EQ(h.percentile_ms(0.99), 80);
}

TEST(ReasonText, HasASentenceForEachReasonThatHasAName) {
  const auto unknown = rt::sentence(static_cast<safety::Reason>(200));
  for (unsigned code = 0; code < 64; ++code) {
    const auto reason = static_cast<safety::Reason>(code);
    EXPECT_EQ(safety::name(reason) == "unknown", rt::sentence(reason) == unknown) << code;
  }
  const auto no_cause = rt::sentence(static_cast<guard::GuardCause>(200));
  for (unsigned code = 0; code < 32; ++code) {
    const auto cause = static_cast<guard::GuardCause>(code);
    EXPECT_EQ(guard::name(cause) == "unknown", rt::sentence(cause) == no_cause) << code;
  }
}

}  // namespace
}  // namespace holdfast::observer
