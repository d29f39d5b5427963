// SPDX-License-Identifier: Apache-2.0
#include <set>
#include <type_traits>

#include <dds/dds.h>
#include <gtest/gtest.h>

#include "bridge/dds/endpoint.hpp"
#include "rt/core/error.hpp"
#include "tests/bridge/dds_domain.hpp"
#include "tests/bridge/scripted_daemon.hpp"

namespace holdfast::bridge::dds {

namespace {

// SR-83: no writer of poses without the key that only PosePublisher has.
static_assert(!std::is_constructible_v<Writer<msg::CompensatedPose>, const Participant&>);
static_assert(!std::is_default_constructible_v<PoseWriterKey>);
static_assert(!std::is_constructible_v<ProtectedWriter<msg::MotionStop>, const Participant&>);

Participant participant() {
  const auto domain = test_domain();
  return Participant({.domain = domain, .configuration = {}});
}

template <class M>
Writer<M> writer_on(const Participant& p) {
  if constexpr (std::is_same_v<M, msg::CompensatedPose>)
    return Writer<M>(p, PoseForger::key());
  else
    return Writer<M>(p);
}

template <class M>
class EveryTopic : public testing::Test {};
struct TypeNames {
  template <class M>
  static std::string GetName(int) {  // NOLINT(readability-identifier-naming): gtest calls it
    return Topic<M>::policy().name + std::string("holdfast/").size();
  }
};
using Messages = testing::Types<msg::CompensatedPose, msg::MotionStop, msg::TrackingHealth,
                                msg::RegistrationInfo, msg::RobotStatus, msg::OperatorCommand>;
TYPED_TEST_SUITE(EveryTopic, Messages, TypeNames);

TYPED_TEST(EveryTopic, WriterAndReaderMatch) {
  const auto a = participant();
  const auto b = participant();
  const auto writer = writer_on<TypeParam>(a);
  const Reader<TypeParam> reader(b);
  EXPECT_TRUE(
      eventually([&] { return writer.status().matched == 1 && reader.status().matched == 1; }));
  EXPECT_EQ(writer.status().incompatible, 0U);
  EXPECT_TRUE(a.qos_mismatches().empty());
  EXPECT_TRUE(b.qos_mismatches().empty());
}

TYPED_TEST(EveryTopic, MessageArrivesUnchanged) {
  const auto a = participant();
  const auto writer = writer_on<TypeParam>(a);
  Reader<TypeParam> reader(a);
  TypeParam sent{};
  protect(sent, 3, 4, std::chrono::seconds(1), read_clocks());
  ASSERT_TRUE(eventually([&] { return writer.status().matched == 1; }));
  ASSERT_TRUE(writer.write(sent));
  std::span<const TypeParam> got;
  ASSERT_TRUE(eventually([&] { return !(got = reader.take()).empty(); }));
  ASSERT_EQ(got.size(), 1U);
  EXPECT_EQ(canonical_crc(got[0]), sent.protection.crc32c);
  EXPECT_EQ(got[0].protection.crc32c, sent.protection.crc32c);
  EXPECT_TRUE(reader.take().empty());
}

TEST(Reader, GivesEveryMessageInOrderAcrossBatches) {
  const auto p = participant();
  const Writer<msg::OperatorCommand> writer(p);
  Reader<msg::OperatorCommand> reader(p);
  ASSERT_TRUE(eventually([&] { return writer.status().matched == 1; }));
  constexpr std::uint32_t kCount = Reader<msg::OperatorCommand>::kBatch;  // = the reader's depth
  for (std::uint32_t i = 0; i < kCount; ++i) {
    msg::OperatorCommand m{};
    m.stop_id = i;
    ASSERT_TRUE(writer.write(m));
  }
  std::uint32_t next = 0;
  ASSERT_TRUE(eventually([&] {
    for (const auto& m : reader.take()) EXPECT_EQ(m.stop_id, next++);
    return next == kCount;
  }));
}

TEST(RegistrationInfoTopic, LateJoinerLearnsTheRegistration) {
  const auto a = participant();
  const Writer<msg::RegistrationInfo> writer(a);
  msg::RegistrationInfo sent{};
  sent.registration_id = 42;
  ASSERT_TRUE(writer.write(sent));
  Reader<msg::RegistrationInfo> reader(a);
  std::span<const msg::RegistrationInfo> got;
  ASSERT_TRUE(eventually([&] { return !(got = reader.take()).empty(); }));
  EXPECT_EQ(got[0].registration_id, 42U);
}

TEST(OperatorCommandTopic, LateJoinerGetsNoOldCommand) {
  const auto a = participant();
  const Writer<msg::OperatorCommand> writer(a);
  msg::OperatorCommand command{};
  command.stop_id = 1;
  ASSERT_TRUE(writer.write(command));
  Reader<msg::OperatorCommand> reader(a);
  ASSERT_TRUE(eventually([&] { return writer.status().matched == 1; }));
  command.stop_id = 2;
  ASSERT_TRUE(writer.write(command));
  std::span<const msg::OperatorCommand> got;
  ASSERT_TRUE(eventually([&] { return !(got = reader.take()).empty(); }));
  EXPECT_EQ(got[0].stop_id, 2U);
}

TEST(Participant, NamesIncompatibleQosOnBothSides) {
  const auto p = participant();
  const auto pose_writer = writer_on<msg::CompensatedPose>(p);
  // A foreign reader that wants poses reliably: it would silently get none.
  const Participant foreign = participant();
  const Entity topic(dds_create_topic(foreign.handle(), &Topic<msg::CompensatedPose>::descriptor(),
                                      Topic<msg::CompensatedPose>::policy().name, nullptr, nullptr),
                     "create a topic");
  dds_qos_t* qos = dds_create_qos();
  dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, 0);
  const Entity reader(dds_create_reader(foreign.handle(), topic.handle(), qos, nullptr), "read");
  ASSERT_TRUE(eventually([&] { return !p.qos_mismatches().empty(); }));
  EXPECT_EQ(p.qos_mismatches().front(),
            "holdfast/compensated_pose: a reader elsewhere requests another RELIABILITY");
  EXPECT_EQ(pose_writer.status().incompatible, 1U);
  EXPECT_EQ(pose_writer.status().matched, 0U);

  // A foreign writer that offers stops unreliably.
  const Reader<msg::MotionStop> stop_reader(p);
  const Entity stop_topic(dds_create_topic(foreign.handle(), &Topic<msg::MotionStop>::descriptor(),
                                           Topic<msg::MotionStop>::policy().name, nullptr, nullptr),
                          "create a topic");
  dds_qset_reliability(qos, DDS_RELIABILITY_BEST_EFFORT, 0);
  const Entity writer(dds_create_writer(foreign.handle(), stop_topic.handle(), qos, nullptr),
                      "write");
  dds_delete_qos(qos);
  ASSERT_TRUE(eventually([&] { return p.qos_mismatches().size() == 2; }));
  EXPECT_EQ(p.qos_mismatches().back(),
            "holdfast/motion_stop: a writer elsewhere offers another RELIABILITY");
  EXPECT_EQ(stop_reader.status().incompatible, 1U);
}

TEST(Participant, RefusesADomainOutOfRange) {
  EXPECT_THROW(Participant({.domain = 233, .configuration = {}}), InputError);
}

TEST(Participant, SaysWhyItCannotStart) {
  try {
    const Participant p({.domain = 101,
                         .configuration = "<General><Interfaces><NetworkInterface "
                                          "name=\"no-such\"/></Interfaces></General>"});
    FAIL() << "joined through an interface that is not there";
  } catch (const UnavailableError& e) {
    EXPECT_NE(std::string(e.what()).find("domain 101"), std::string::npos) << e.what();
  }
}

TEST(TopicPolicies, AreWholeAndDistinct) {
  std::set<std::string> names;
  std::set<safety::DataId> ids;
  for (const auto& policy : topic_policies()) {
    names.insert(policy.name);
    ids.insert(policy.data_id);
    EXPECT_GT(policy.validity.count(), 0);
    EXPECT_GE(policy.reader_depth, policy.writer_depth);
    EXPECT_TRUE(policy.lifespan.count() == 0 || policy.lifespan >= policy.validity);
  }
  EXPECT_EQ(names.size(), 7U);
  EXPECT_EQ(ids.size(), 7U);
}

}  // namespace
}  // namespace holdfast::bridge::dds
