// SPDX-License-Identifier: Apache-2.0
// What the publisher's and the robot's threads ask of the heap per message, Cyclone's part of it
// included.
#include <gtest/gtest.h>

#include "bridge/client/client.hpp"
#include "tests/bridge/dds_domain.hpp"
#include "tests/bridge/heap_counter.hpp"
#include "tests/bridge/scripted_daemon.hpp"

namespace holdfast::bridge::dds {
namespace {

constexpr int kMessages = 2000;

template <class M>
ProtectedWriter<M> protected_writer(const Participant& p) {
  if constexpr (std::is_same_v<M, msg::CompensatedPose>)
    return ProtectedWriter<M>(p, 1, PoseForger::key());
  else
    return ProtectedWriter<M>(p, 1);
}

template <class M>
class HeapOfTopic : public testing::Test {};
struct TypeNames {
  template <class M>
  static std::string GetName(int) {  // NOLINT(readability-identifier-naming): gtest calls it
    return Topic<M>::policy().name + std::string("holdfast/").size();
  }
};
using Messages = testing::Types<msg::CompensatedPose, msg::MotionStop, msg::TrackingHealth,
                                msg::RegistrationInfo, msg::RobotStatus, msg::OperatorCommand>;
TYPED_TEST_SUITE(HeapOfTopic, Messages, TypeNames);

TEST(HeapCounter, CountsWhatCyclonesCallersAskFor) {
  EXPECT_GT(
      heap_requests_in([] { const Participant p({.domain = test_domain(), .configuration = {}}); }),
      0);
}

// Cyclone 0.10.2 keeps serialised samples of up to 256 bytes for reuse; larger ones it allocates
// and grows once in each write, on the writing thread, and frees after it.
template <class M>
constexpr int kRequestsPerWrite = sizeof(M) > 256 ? 2 : 0;

TYPED_TEST(HeapOfTopic, IsUsedByNoTakeAndByLargeWritesOnly) {
  const Participant here({.domain = test_domain(), .configuration = {}});
  auto writer = protected_writer<TypeParam>(here);
  Reader<TypeParam> reader(here);
  ASSERT_TRUE(eventually([&] { return writer.status().matched == 1; }));
  TypeParam message{};
  long by_writes = 0, by_takes = 0;
  const auto exchange = [&] {
    for (int i = 0; i < kMessages; ++i) {
      by_writes += heap_requests_in([&] { ASSERT_TRUE(writer.publish(message)); });
      by_takes += heap_requests_in([&] {
        while (!reader.take().empty()) {
        }
      });
    }
  };
  exchange();  // Cyclone's own pools fill
  by_writes = by_takes = 0;
  exchange();
  this->RecordProperty("heap_requests_per_1000_writes",
                       static_cast<int>(by_writes * 1000 / kMessages));
  EXPECT_EQ(by_writes, kMessages * kRequestsPerWrite<TypeParam>);
  EXPECT_EQ(by_takes, 0);
}

TEST(HeapOfClient, IsNotUsedByPollWaitAndReport) {
  const Participant there({.domain = test_domain(), .configuration = {}});
  ScriptedDaemon daemon(there);
  client::Parameters parameters;
  parameters.domain = test_domain();
  client::Client robot(parameters);
  ASSERT_TRUE(eventually([&] { return daemon.has_robot(); }));
  bool was_permitted = false;
  long by_robot = 0;
  const auto cycles = [&] {
    for (int i = 0; i < kMessages; ++i) {
      daemon.permit();
      by_robot += heap_requests_in([&] {
        robot.wait(std::chrono::milliseconds(1));
        was_permitted = robot.poll().is_permitted() || was_permitted;
        (void)robot.report({});
      });
    }
  };
  cycles();
  by_robot = 0;
  cycles();
  EXPECT_EQ(by_robot, 0);
  EXPECT_TRUE(was_permitted);
}

}  // namespace
}  // namespace holdfast::bridge::dds
