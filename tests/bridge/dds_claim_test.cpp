// SPDX-License-Identifier: Apache-2.0
#include <gtest/gtest.h>

#include "bridge/dds/daemon_claim.hpp"
#include "rt/core/error.hpp"
#include "tests/bridge/dds_domain.hpp"
#include "tests/bridge/dds_peer.hpp"
#include "tests/bridge/scripted_daemon.hpp"

namespace holdfast::bridge::dds {
namespace {

using namespace std::chrono_literals;

// Returns when it has seen what it looks for; the bound only ends a failing test.
constexpr auto kLook = 20s;

std::string refusal_of_claim(const Participant& participant) {
  try {
    const DaemonClaim claim(participant, kLook);
    return "claimed";
  } catch (const InputError& e) {
    return e.what();
  }
}

TEST(DomainLock, IsHeldOnceAndFreedAtTheEnd) {
  const auto domain = test_domain();
  {
    const DomainLock lock(domain);
    EXPECT_THROW(DomainLock{domain}, InputError);
  }
  EXPECT_NO_THROW(DomainLock{domain});
}

TEST(DaemonClaim, RefusesASecondDaemonOnThisHostByItsPid) {
  RecordProperty("requirement", "SR-81");
  const auto domain = test_domain();
  const Peer first("claim", domain);
  ASSERT_EQ(first.first_line(), "ready");
  const Participant participant({.domain = domain, .configuration = {}});
  EXPECT_EQ(refusal_of_claim(participant), "domain " + std::to_string(domain) +
                                               " already has a Holdfast daemon (pid " +
                                               std::to_string(first.pid()) + ")");
}

TEST(DaemonClaim, IsFreeAgainAfterTheDaemonWasKilled) {
  const auto domain = test_domain();
  Peer first("claim", domain);
  ASSERT_EQ(first.first_line(), "ready");
  first.kill();
  EXPECT_NO_THROW(DomainLock{domain});
}

TEST(DaemonClaim, RefusesWhenDiscoveryShowsAWriterElsewhere) {
  RecordProperty("requirement", "SR-81");
  const auto domain = test_domain();
  const Peer elsewhere("rogue", domain);
  ASSERT_EQ(elsewhere.first_line(), "ready");
  const Participant participant({.domain = domain, .configuration = {}});
  EXPECT_EQ(refusal_of_claim(participant),
            "domain " + std::to_string(domain) +
                " already has a Holdfast daemon: another participant writes "
                "holdfast/compensated_pose");
}

TEST(DaemonClaim, DoesNotTakeOwnWritersForASecondPublisher) {
  const Participant participant({.domain = test_domain(), .configuration = {}});
  DaemonClaim claim(participant, 0s);
  const ScriptedDaemon own(participant);
  const Reader<msg::CompensatedPose> reader(participant);
  ASSERT_TRUE(eventually([&] { return reader.status().matched == 1; }));
  EXPECT_FALSE(claim.second_publisher());
}

TEST(DaemonClaim, SeesASecondPublisherComeAndGoAtRunTime) {
  RecordProperty("requirement", "SR-81");
  const auto domain = test_domain();
  const Participant participant({.domain = domain, .configuration = {}});
  DaemonClaim claim(participant, 0s);
  EXPECT_FALSE(claim.second_publisher());
  Peer rogue("rogue", domain);
  ASSERT_EQ(rogue.first_line(), "ready");
  EXPECT_TRUE(eventually([&] { return claim.second_publisher(); }));
  rogue.terminate();
  EXPECT_TRUE(eventually([&] { return !claim.second_publisher(); }));
}

}  // namespace
}  // namespace holdfast::bridge::dds
