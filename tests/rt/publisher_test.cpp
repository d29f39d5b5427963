// SPDX-License-Identifier: Apache-2.0
// The publishing thread's work over real DDS: what a robot hears of each decision.
#include "rt/publisher.hpp"

#include <optional>
#include <type_traits>
#include <vector>

#include <gtest/gtest.h>

#include "rt/core/clock.hpp"
#include "tests/bridge/dds_domain.hpp"
#include "tests/safety/good_inputs.hpp"

namespace holdfast::rt {
namespace {

using namespace std::chrono_literals;
namespace dds = bridge::dds;
using safety::Reason;

DaemonConfig config_for_test() {
  DaemonConfig config;
  config.domain = static_cast<int>(dds::test_domain());
  config.registration.checksum = "sha256:0123456789abcdef";
  return config;
}

class PublisherTest : public ::testing::Test {
 public:
  void SetUp() override {
    ASSERT_TRUE(dds::eventually(
        [&] { return stops.status().matched == 1 && poses.status().matched == 1; }));
  }
  void run() { publisher.run(reports, withdrawals, estimates, inbox, sources); }
  void report(const safety::Decision& decision) {
    CycleReport r;
    r.output.decision = decision;
    r.cycles = ++cycles;
    reports.publish(r);
  }
  safety::Decision permitted() {
    gate.now = monotonic_now();
    return gate.to_permitted();
  }
  void collect() {
    for (const msg::MotionStop& stop : stops.take()) heard_stops.push_back(stop);
    for (const msg::CompensatedPose& pose : poses.take()) heard_poses.push_back(pose);
  }
  /// The first health message of the next run; empty when none comes.
  std::optional<msg::TrackingHealth> run_and_hear_health() {
    if (!dds::eventually([&] { return health.status().matched == 1; })) return std::nullopt;
    run();
    std::optional<msg::TrackingHealth> first;
    dds::eventually([&] {
      if (const auto heard = health.take(); !heard.empty()) first = heard.front();
      return first.has_value();
    });
    return first;
  }

  Publisher publisher{config_for_test(), safety::RegistrationInput{}, [] {
                        safety::ReasonSet set;
                        set.insert(Reason::not_real_time);
                        return set;
                      }()};
  dds::Participant robot{{.domain = dds::test_domain(), .configuration = {}}};
  dds::Reader<msg::MotionStop> stops{robot};
  dds::Reader<msg::CompensatedPose> poses{robot};
  dds::Reader<msg::TrackingHealth> health{robot};
  dds::Reader<msg::RegistrationInfo> registrations{robot};
  Mailbox<CycleReport> reports;
  StopLatch withdrawals;
  Mailbox<StampedEstimate> estimates;
  ControlInbox inbox;
  HealthSources sources;
  safety::test::GateDriver gate;
  std::uint64_t cycles = 0;
  std::vector<msg::MotionStop> heard_stops;
  std::vector<msg::CompensatedPose> heard_poses;
};

// The compiler holds the requirement; this names it where the exit is used.
static_assert(!std::is_constructible_v<safety::ApprovedPose>);
static_assert(!std::is_constructible_v<dds::Writer<msg::CompensatedPose>, const dds::Participant&>);
static_assert(!std::is_invocable_v<decltype(&dds::PosePublisher::publish), dds::PosePublisher&,
                                   const msg::CompensatedPose&, const dds::PoseOrigin&>);

TEST_F(PublisherTest, TellsPermissionBeforeItSendsThePose) {
  RecordProperty("requirement", "SR-83");
  report(permitted());
  run();
  ASSERT_TRUE(dds::eventually([&] {
    collect();
    return !heard_poses.empty() && !heard_stops.empty();
  }));
  EXPECT_TRUE(heard_stops.front().is_permitted);
  EXPECT_LE(heard_stops.front().protection.t_monotonic_ns,
            heard_poses.front().protection.t_monotonic_ns);
}

TEST_F(PublisherTest, PublishesAWithdrawalThatALaterPermissionOvertook) {
  RecordProperty("requirement", "SR-73");
  report(permitted());
  run();
  safety::ReasonSet reasons;
  reasons.insert(Reason::frame_frozen);
  withdrawals.raise(reasons.bits(), ++cycles);
  report(gate.step());  // permitted again, before the publisher ran
  run();
  ASSERT_TRUE(dds::eventually([&] {
    collect();
    return heard_stops.size() >= 3;
  }));
  EXPECT_FALSE(heard_stops[1].is_permitted);
  EXPECT_EQ(heard_stops[1].cause, static_cast<std::uint8_t>(Reason::frame_frozen));
  EXPECT_TRUE(heard_stops[2].is_permitted);
}

TEST_F(PublisherTest, SendsNoPoseThatIsOlderThanAWithdrawal) {
  RecordProperty("requirement", "SR-73");
  report(permitted());
  withdrawals.raise(0, cycles + 1);  // decided after that report, whose own report is still to come
  run();
  ASSERT_TRUE(dds::eventually([&] {
    collect();
    return !heard_stops.empty();
  }));
  EXPECT_FALSE(heard_stops.front().is_permitted);
  publisher.publish_end();  // sent after a pose would have been
  ASSERT_TRUE(dds::eventually([&] {
    collect();
    return heard_stops.size() >= 2;
  }));
  EXPECT_TRUE(heard_poses.empty());
}

TEST_F(PublisherTest, SendsNoPoseThatIsOlderThanAWithdrawalThatItToldBefore) {
  RecordProperty("requirement", "SR-73");
  withdrawals.raise(0, cycles + 2);
  run();  // the withdrawal of the second cycle is told ...
  report(permitted());
  run();  // ... before the report of the first is there
  publisher.publish_end();
  ASSERT_TRUE(dds::eventually([&] {
    collect();
    return heard_stops.size() >= 2;
  }));
  for (const msg::MotionStop& stop : heard_stops) EXPECT_FALSE(stop.is_permitted);
  EXPECT_TRUE(heard_poses.empty());
}

TEST_F(PublisherTest, SaysWithEachHealthMessageThatItIsNotRealTime) {
  RecordProperty("requirement", "SR-75");
  estimates.publish({});
  const auto heard = run_and_hear_health();
  ASSERT_TRUE(heard);
  EXPECT_TRUE(safety::ReasonSet{heard->advisories}.contains(Reason::not_real_time));
}

TEST_F(PublisherTest, SaysWithEachHealthMessageThatADiskRefusesTheRecording) {
  RecordProperty("requirement", "SR-121");
  sources.advisories.insert(Reason::not_recording);
  estimates.publish({});
  const auto heard = run_and_hear_health();
  ASSERT_TRUE(heard);
  EXPECT_TRUE(safety::ReasonSet{heard->advisories}.contains(Reason::not_recording));
}

TEST_F(PublisherTest, HealthCarriesTheJudgedUncertaintyAndTheKeyframesRegistration) {
  RecordProperty("requirement", "SR-36");
  CycleReport judged;
  judged.output.sigma_target_mm = 0.123;
  judged.cycles = ++cycles;
  reports.publish(judged);
  StampedEstimate estimate;
  estimate.registration_id = 0xFEDC'BA98'7654'3210U;
  estimates.publish(estimate);
  const auto heard = run_and_hear_health();
  ASSERT_TRUE(heard);
  EXPECT_EQ(heard->sigma_target_mm, 0.123);
  EXPECT_EQ(heard->registration_id, 0xFEDC'BA98'7654'3210U);
}

TEST_F(PublisherTest, AnnouncesTheRegistrationToLateJoiners) {
  dds::Participant late{{.domain = dds::test_domain(), .configuration = {}}};
  dds::Reader<msg::RegistrationInfo> reader{late};
  std::size_t heard = 0;
  EXPECT_TRUE(dds::eventually([&] {
    heard += reader.take().size();
    return heard > 0;
  }));
}

TEST_F(PublisherTest, EndsWithAMessageThatDoesNotPermit) {
  report(permitted());
  run();
  publisher.publish_end();
  ASSERT_TRUE(dds::eventually([&] {
    collect();
    return heard_stops.size() >= 2;
  }));
  EXPECT_FALSE(heard_stops.back().is_permitted);
}

}  // namespace
}  // namespace holdfast::rt
