// SPDX-License-Identifier: Apache-2.0
// The guard's share in the client's decision, without DDS: time passed in.
#include <gtest/gtest.h>

#include "bridge/client/permission.hpp"

namespace holdfast::client {
namespace {

using bridge::dds::protect;
using std::chrono::nanoseconds;
using namespace std::chrono_literals;

class GuardedPermission : public ::testing::Test {
 protected:
  [[nodiscard]] Clocks clocks() const { return {now_, now_ + 1'700'000'000s}; }
  /// One message of each stream that is alive, a millisecond later; then the answer.
  Permission step() {
    now_ += 1ms;
    msg::MotionStop stop{};
    stop.mode = 3;
    stop.is_permitted = true;
    protect(stop, 7, ++stop_counter_, 20ms, clocks());
    core_.take(stop, clocks());
    if (has_guard) {
      msg::GuardPermission guard{};
      guard.is_permitted = is_vouched;
      guard.cause = is_vouched != is_contradictory ? 0 : 2;
      guard.daemon_source = vouched_source;
      guard.t_changed_ns = t_changed.count();
      protect(guard, 8, ++guard_counter_, 10ms, clocks());
      core_.take(guard, clocks());
    }
    msg::CompensatedPose pose{};
    pose.t_pose_ns = now_.count();
    pose.t_exposure_ns = (now_ - 20ms).count();
    pose.t_frame_received_ns = (now_ - 15ms).count();
    pose.rotation_xyzw[3] = 1;
    for (std::size_t i = 0; i < 6; ++i) pose.covariance[7 * i] = 0.01;
    protect(pose, 7, ++pose_counter_, 15ms, clocks());
    core_.take(pose, clocks());
    return core_.decide(now_);
  }
  Permission run(int steps) {
    Permission permission;
    for (int i = 0; i < steps; ++i) permission = step();
    return permission;
  }
  bool has_guard = true, is_vouched = true, is_contradictory = false;
  std::uint32_t vouched_source = 7;
  nanoseconds t_changed{};
  nanoseconds now_ = 1000s;
  PermissionCore core_{Parameters{}};
  std::uint32_t stop_counter_ = 0, guard_counter_ = 0, pose_counter_ = 0;
};

TEST_F(GuardedPermission, NeedsTheGuardByDefault) {
  RecordProperty("requirement", "SR-105");
  has_guard = false;
  EXPECT_EQ(run(10).refusal, Refusal::no_guard_message);
  has_guard = true;
  EXPECT_TRUE(run(2).is_permitted());
}

TEST_F(GuardedPermission, EndsWithTheGuardsWithdrawal) {
  RecordProperty("requirement", "SR-105");
  ASSERT_TRUE(run(3).is_permitted());
  is_vouched = false;
  const Permission p = step();
  EXPECT_EQ(p.refusal, Refusal::guard_withheld);
  EXPECT_EQ(p.guard_cause, 2);
}

TEST_F(GuardedPermission, EndsWhenTheGuardFallsSilent) {
  RecordProperty("requirement", "SR-105");
  const Permission before = run(3);
  ASSERT_TRUE(before.is_permitted());
  EXPECT_LE(before.pose->t_valid_until_ns, (now_ + 10ms).count());
  has_guard = false;
  EXPECT_TRUE(run(10).is_permitted());  // its last message was sent 10 ms ago
  EXPECT_EQ(step().refusal, Refusal::guard_silent);
}

TEST_F(GuardedPermission, AGuardOfAnotherDaemonDoesNotCount) {
  RecordProperty("requirement", "SR-105");
  vouched_source = 70;
  EXPECT_EQ(run(5).refusal, Refusal::sources_differ);
}

TEST_F(GuardedPermission, APoseFromBeforeTheGuardsPermissionIsNotUsed) {
  ASSERT_TRUE(run(3).is_permitted());
  t_changed = now_ + 5ms;
  EXPECT_EQ(run(2).refusal, Refusal::pose_before_permission);
  EXPECT_TRUE(run(3).is_permitted());
}

TEST_F(GuardedPermission, AContradictoryMessageOfTheGuardIsRefused) {
  RecordProperty("requirement", "SR-52");
  ASSERT_TRUE(run(3).is_permitted());
  is_contradictory = true;
  EXPECT_EQ(step().refusal, Refusal::contradictory_stop);
}

TEST_F(GuardedPermission, CanBeSwitchedOffExplicitly) {
  Parameters parameters;
  parameters.guard = Guard::absent;
  core_ = PermissionCore(parameters);
  has_guard = false;
  EXPECT_TRUE(run(3).is_permitted());
}

}  // namespace
}  // namespace holdfast::client
