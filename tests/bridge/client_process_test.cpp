// SPDX-License-Identifier: Apache-2.0
// The client over the real middleware: between processes, and with a daemon that is killed.
#include <random>

#include <gtest/gtest.h>

#include "bridge/client/client.hpp"
#include "bridge/dds/inputs.hpp"
#include "tests/bridge/dds_domain.hpp"
#include "tests/bridge/dds_peer.hpp"
#include "tests/bridge/scripted_daemon.hpp"

namespace holdfast::client {
namespace {

using bridge::dds::eventually;
using bridge::dds::Participant;
using bridge::dds::Peer;
using bridge::dds::read_clocks;
using bridge::dds::ScriptedDaemon;
using bridge::dds::test_domain;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

Parameters on_test_domain() {
  Parameters parameters;
  parameters.domain = test_domain();
  return parameters;
}

TEST(ClientOverDds, GetsPosesFromAnotherProcess) {
  Client client(on_test_domain());
  EXPECT_EQ(client.poll().refusal, Refusal::no_stop_message);
  const Peer daemon("publish", test_domain());
  ASSERT_EQ(daemon.first_line(), "ready");
  Permission p;
  ASSERT_TRUE(eventually([&] {
    client.wait(milliseconds(100));
    p = client.poll();
    return p.is_permitted();
  }));
  EXPECT_EQ(p.pose->translation_mm[2], 200);
  EXPECT_EQ(p.pose->frame, p.pose->counter);
  EXPECT_LE(p.pose->t_valid_until_ns,
            p.pose->t_pose_ns + nanoseconds(ScriptedDaemon::kPoseValidity).count());
  EXPECT_TRUE(client.mismatches().empty());
}

TEST(ClientOverDds, RobotHasStoppedWithinTheValidityOfAKilledDaemon) {
  RecordProperty("requirement", "SR-55");
  std::mt19937 random(1);
  nanoseconds worst{};
  for (int run = 0; run < 20; ++run) {
    Client client(on_test_domain());
    Peer daemon("publish", test_domain());
    ASSERT_EQ(daemon.first_line(), "ready");
    Permission p;
    ASSERT_TRUE(eventually([&] {
      client.wait(milliseconds(100));
      p = client.poll();
      return p.is_permitted();
    })) << name(p.refusal);
    const nanoseconds t_kill =
        read_clocks().monotonic +
        std::chrono::microseconds(std::uniform_int_distribution<int>(0, 30'000)(random));
    while (read_clocks().monotonic < t_kill) p = client.poll();
    daemon.kill();
    const nanoseconds t_dead = read_clocks().monotonic;

    // Everything below follows from stamps: how late this thread runs does not matter.
    nanoseconds t_last_permitted{};
    for (;;) {
      const nanoseconds t_before = read_clocks().monotonic;
      p = client.poll();
      if (!p.is_permitted() && t_before > t_dead + ScriptedDaemon::kStopValidity) break;
      if (!p.is_permitted()) {
        client.wait(milliseconds(1));
        continue;
      }
      t_last_permitted = nanoseconds(p.t_ns);
      ASSERT_LE(p.t_ns, p.pose->t_valid_until_ns);
      ASSERT_LE(p.pose->t_valid_until_ns,
                p.pose->t_pose_ns + nanoseconds(ScriptedDaemon::kPoseValidity).count());
      ASSERT_LE(p.pose->t_pose_ns, t_dead.count());
      ASSERT_LE(t_before, t_dead + ScriptedDaemon::kPoseValidity);
      client.wait(milliseconds(100));
    }
    worst = std::max(worst, t_last_permitted - t_kill);
  }
  RecordProperty("last_permission_after_kill_us_max", static_cast<int>(worst.count() / 1000));
}

// A daemon in this process, so that each message is what the test makes it.
class ScriptedClientTest : public testing::Test {
 public:
  void SetUp() override {
    ASSERT_TRUE(eventually([&] { return daemon.has_robot(); }));
    permit();
  }
  void permit() {
    ASSERT_TRUE(eventually([&] {
      daemon.permit();
      return client.poll().is_permitted();
    }));
  }
  // Polls until what was written has arrived, that is, until the answer is no.
  Refusal refusal() {
    Permission p;
    EXPECT_TRUE(eventually([&] { return !(p = client.poll()).is_permitted(); }));
    return p.refusal;
  }

  Participant participant{{.domain = test_domain(), .configuration = {}}};
  ScriptedDaemon daemon{participant};
  Client client{on_test_domain()};
};

TEST_F(ScriptedClientTest, FailsSafeOnSilence) {
  RecordProperty("requirement", "SR-51");
  const auto r = refusal();
  EXPECT_TRUE(r == Refusal::pose_silent || r == Refusal::stop_silent) << name(r);
}

TEST_F(ScriptedClientTest, StopMessageEndsPermission) {
  RecordProperty("requirement", "SR-53");
  Permission p;
  ASSERT_TRUE(eventually([&] {
    daemon.stop();
    daemon.write(daemon.pose());  // good poses go on: the stop alone decides
    p = client.poll();
    return p.stop.is_latched;
  }));
  EXPECT_FALSE(p.is_permitted());
}

TEST_F(ScriptedClientTest, RefusesABadCrcOnTheWire) {
  RecordProperty("requirement", "SR-52");
  auto pose = daemon.pose();
  pose.translation_mm[0] = 1;  // after the CRC
  daemon.write(pose);
  ASSERT_TRUE(eventually(
      [&] { return !client.poll().is_permitted() && client.counts().poses_refused > 0; }));
  EXPECT_EQ(client.counts().refused_messages[static_cast<std::size_t>(Refusal::bad_crc)], 1U);
}

TEST_F(ScriptedClientTest, RefusesASecondSourceOnTheWire) {
  RecordProperty("requirement", "SR-52");
  ScriptedDaemon second(participant);
  ASSERT_TRUE(eventually([&] { return second.has_robot(); }));
  ASSERT_TRUE(eventually([&] {
    daemon.permit();
    second.permit();
    return client.poll().refusal == Refusal::second_source;
  }));
}

TEST_F(ScriptedClientTest, WaitEndsWhenPermissionDoes) {
  ASSERT_TRUE(client.poll().is_permitted() || (permit(), true));
  client.wait(std::chrono::hours(1));  // hangs if the expiry does not end it
  SUCCEED();
}

TEST_F(ScriptedClientTest, ReportReachesTheDaemonChecked) {
  bridge::dds::InputReader inputs(participant);
  ASSERT_TRUE(eventually([&] { return inputs.robot_endpoint().matched == 1; }));
  bridge::dds::ReceivedInputs received;
  ASSERT_TRUE(eventually([&] {
    EXPECT_TRUE(client.report({.is_enabled = true, .has_fault = true, .fault_code = 4}));
    received = inputs.poll();
    return received.robot.has_value();
  }));
  EXPECT_TRUE(received.robot->has_fault);
  EXPECT_FALSE(received.is_corrupt);
}

TEST(ClientParameters, AreRefusedByNameValueAndRange) {
  auto parameters = on_test_domain();
  parameters.validity_max = milliseconds(21);
  try {
    const Client client(parameters);
    FAIL();
  } catch (const std::runtime_error& e) {
    EXPECT_STREQ(e.what(), "client: validity_max is 21.000000, range 1.000000..20.000000 ms");
  }
  parameters = on_test_domain();
  parameters.recovery_messages = 0;
  EXPECT_THROW(Client{parameters}, std::runtime_error);
}

}  // namespace
}  // namespace holdfast::client
