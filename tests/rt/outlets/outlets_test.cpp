// SPDX-License-Identifier: Apache-2.0
// What the outlets tell, and when nothing: in virtual time, without DDS or sockets.
#include <limits>

#include <gtest/gtest.h>

#include "perception/motion_estimate.hpp"
#include "rt/outlets/igtl_outlet.hpp"
#include "rt/outlets/ros2_outlet.hpp"
#include "safety/gate.hpp"
#include "tests/rt/observed_room.hpp"

namespace holdfast::outlets {
namespace {

using bridge::dds::Clocks;
using bridge::ros2::DiagnosticLevel;
using safety::Mode;
using safety::Reason;
using namespace std::chrono_literals;

/// A set-up at work in virtual time; a test spoils one thing.
class Outlets : public observer::ObservedRoom {
 protected:
  void say(Mode mode, Reason cause, bool is_permitted) {
    msg::MotionStop m{};
    m.mode = static_cast<std::uint8_t>(mode);
    m.cause = static_cast<std::uint8_t>(cause);
    m.is_permitted = is_permitted;
    m.is_latched = mode == Mode::stop_latched;
    m.t_changed_ns = now_.count();
    send(m);
  }
  void vouch() {
    msg::GuardPermission m{};
    m.is_permitted = true;
    m.daemon_source = kDaemon;
    send(m, kGuard);
  }
  void permit() {
    say(Mode::permitted, Reason::none, true);
    vouch();
  }
  [[nodiscard]] msg::CompensatedPose pose() const {
    msg::CompensatedPose m{};
    m.t_pose_ns = (now_ - 1ms).count();
    m.translation_mm[0] = 100;
    m.translation_mm[1] = -20;
    m.translation_mm[2] = 300;
    m.rotation_xyzw[2] = m.rotation_xyzw[3] = std::sqrt(0.5);
    m.target_robot_mm[0] = 110;
    for (std::size_t i = 0; i < 36; ++i) m.covariance[i] = static_cast<double>(i % 6 + i / 6);
    return m;
  }
  [[nodiscard]] msg::TrackingHealth health() const {
    msg::TrackingHealth m{};
    m.frame = 5;
    m.registration_id = 9;
    m.t_exposure_ns = (now_ - 12ms).count();
    m.site_translation_mm[0] = 1;
    m.site_rotation_xyzw[3] = 1;
    return m;
  }
  void register_site() {
    msg::RegistrationInfo m{};
    m.is_loaded = true;
    m.registration_id = 9;
    m.translation_mm[2] = 250;
    m.rotation_xyzw[3] = 1;
    send(m);
  }
  void work() {
    permit();
    send(pose());
    register_site();
    send(health());
  }
  [[nodiscard]] bool has_pose() const { return live_pose(state_, now_).has_value(); }
  [[nodiscard]] bool has_site() const { return live_site(state_, now_).has_value(); }
};

TEST_F(Outlets, TellPosesOnlyWhilePermittedByDaemonAndGuard) {
  RecordProperty("requirement", "SR-141");
  EXPECT_FALSE(has_pose());
  send(pose());
  EXPECT_FALSE(has_pose()) << "a pose alone is none";
  work();
  EXPECT_TRUE(has_pose());
  EXPECT_TRUE(has_site());
  for (const auto& [mode, cause] : {std::pair{Mode::hold, Reason::estimate_stale},
                                    {Mode::stop_latched, Reason::drift_exceeded},
                                    {Mode::unregistered, Reason::not_registered},
                                    {Mode::init, Reason::initialising}}) {
    say(mode, cause, false);
    EXPECT_FALSE(has_pose()) << safety::name(mode);
    EXPECT_FALSE(has_site()) << safety::name(mode);
  }
  say(Mode::ready, Reason::not_armed, false);
  EXPECT_FALSE(has_pose()) << "not armed";
  EXPECT_TRUE(has_site()) << "followed, and lacks nothing but to be armed";
}

TEST_F(Outlets, TellNothingWhenDaemonOrGuardIsSilent) {
  RecordProperty("requirement", "SR-141");
  work();
  now_ += 60ms;
  say(Mode::permitted, Reason::none, true);
  now_ += 60ms;
  EXPECT_EQ(state_.shown(now_).reason, "guard_silent");
  EXPECT_FALSE(has_pose());
  EXPECT_FALSE(has_site());
  vouch();
  now_ += 60ms;
  EXPECT_EQ(state_.shown(now_).reason, "daemon_silent");
  EXPECT_FALSE(has_pose());
  EXPECT_FALSE(has_site());
}

TEST_F(Outlets, TellNoPoseFromBeforeThePermissionOrOfAnotherSource) {
  RecordProperty("requirement", "SR-141");
  send(pose());
  now_ += 1ms;
  permit();
  EXPECT_FALSE(has_pose()) << "sent before the permission in force was given";
  send(pose(), kDaemon + 1);
  EXPECT_FALSE(has_pose()) << "of another source";
  send(pose());
  EXPECT_TRUE(has_pose());
  now_ += 101ms;
  permit();
  EXPECT_FALSE(has_pose()) << "permitted, but no pose for 100 ms";
}

TEST_F(Outlets, TellNothingOfALostOrOldEstimate) {
  RecordProperty("requirement", "SR-141");
  work();
  msg::TrackingHealth lost = health();
  lost.status = static_cast<std::uint8_t>(perception::TrackingStatus::lost);
  msg::TrackingHealth old = health();
  old.t_exposure_ns = (now_ - kSiteAgeMax - 1ms).count();
  msg::TrackingHealth unregistered = health();
  unregistered.registration_id = 8;
  for (const msg::TrackingHealth& bad : {lost, old, unregistered}) {
    send(bad);
    EXPECT_FALSE(has_site());
    send(health());
    EXPECT_TRUE(has_site());
  }
}

TEST_F(Outlets, TellNoNumberThatIsNone) {
  RecordProperty("requirement", "SR-141");
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  work();
  const auto refuses = [this](auto spoil) {
    msg::CompensatedPose m = pose();
    spoil(m);
    send(m);
    return !has_pose();
  };
  EXPECT_TRUE(refuses([](auto& m) { m.translation_mm[1] = kNan; }));
  EXPECT_TRUE(refuses([](auto& m) { m.rotation_xyzw[0] = kNan; }));
  EXPECT_TRUE(refuses([](auto& m) { m.rotation_xyzw[3] = 2; }));
  EXPECT_TRUE(refuses([](auto& m) { m.covariance[7] = kNan; }));
  EXPECT_TRUE(refuses([](auto& m) { m.target_robot_mm[2] = kNan; }));
  EXPECT_FALSE(refuses([](auto&) {}));
  msg::TrackingHealth m = health();
  m.site_translation_mm[0] = kNan;
  send(m);
  EXPECT_FALSE(has_site());
}

TEST_F(Outlets, StampPosesWithTheirOwnInstantInUtc) {
  work();
  EXPECT_EQ(live_pose(state_, now_)->t_utc, clocks().utc - 1ms);
  EXPECT_EQ(live_site(state_, now_)->t_utc, clocks().utc - 12ms);
}

TEST_F(Outlets, TurnAxesAsTheirNamesSay) {
  work();
  const LivePose pose = *live_pose(state_, now_);
  const LiveSite site = *live_site(state_, now_);
  // A point 10 mm in front of, 20 mm left of and 30 mm above the CT's origin, in the CT (LPS).
  const Eigen::Vector3d p_patient(10, 20, 30), p_ct(20, -10, 30);
  const auto fixed = static_transforms(0ns);
  EXPECT_TRUE((fixed[0].T_frame_child_mm * p_ct).isApprox(p_patient));
  // 10 mm ahead of, 20 mm left of and 30 mm above the camera lies at -20, -30, 10 in its optics.
  EXPECT_TRUE((fixed[1].T_frame_child_mm * p_patient).isApprox(Eigen::Vector3d(-20, -30, 10)));
  EXPECT_TRUE(
      (to_transform(pose, "base").T_frame_child_mm * p_patient).isApprox(pose.T_robot_ct * p_ct));
  // Through the tree, from the optics to the CT, and back by what the tracker measured.
  const auto tree = to_transforms(site);
  EXPECT_EQ(tree[0].frame, fixed[0].child_frame);
  EXPECT_EQ(tree[0].child_frame, tree[1].frame);
  EXPECT_EQ(tree[1].child_frame, fixed[1].frame);
  const Eigen::Vector3d p_optical = site.T_camera_site * (site.T_site_ct * p_ct);
  EXPECT_TRUE((tree[0].T_frame_child_mm * tree[1].T_frame_child_mm * p_optical).isApprox(p_ct));
  // Slicer's RAS: right and anterior are the negative of left and posterior.
  const Eigen::Vector3d p_ras(-20, 10, 30);
  EXPECT_TRUE((T_patient_camera(site) * p_optical).isApprox(p_ras));
  EXPECT_TRUE((T_patient_robot(pose) * (pose.T_robot_ct * p_ct)).isApprox(p_ras));
}

TEST_F(Outlets, SayInDiagnosticsAndStatusWhyThereIsNoPose) {
  RecordProperty("requirement", "SR-141");
  using bridge::openigtlink::StatusCode;
  const auto told = [this] { return diagnostics(state_, now_)[0]; };
  EXPECT_EQ(told().level, DiagnosticLevel::stale);
  EXPECT_EQ(to_status(state_, now_).code, StatusCode::time_out);
  work();
  EXPECT_EQ(told().level, DiagnosticLevel::ok);
  EXPECT_EQ(to_status(state_, now_).code, StatusCode::ok);
  EXPECT_EQ(to_status(state_, now_).sub_code, 0);
  say(Mode::stop_latched, Reason::drift_exceeded, false);
  EXPECT_EQ(told().level, DiagnosticLevel::error);
  EXPECT_EQ(told().values[0].second, "drift_exceeded");
  const auto status = to_status(state_, now_);
  EXPECT_EQ(status.code, StatusCode::emergency);
  EXPECT_EQ(status.sub_code, static_cast<int>(Reason::drift_exceeded));
  EXPECT_EQ(status.name, "drift_exceeded");
  say(Mode::hold, Reason::estimate_stale, false);
  EXPECT_EQ(told().level, DiagnosticLevel::warn);
  EXPECT_EQ(to_status(state_, now_).code, StatusCode::not_ready);
}

}  // namespace
}  // namespace holdfast::outlets
