// SPDX-License-Identifier: Apache-2.0
// Every topic against another DDS implementation, Fast DDS, byte for byte: what goes over the wire
// is what message_golden.py makes of the IDL alone, in both directions.
#include <filesystem>
#include <fstream>
#include <sstream>
#include <tuple>

#include <gtest/gtest.h>

#include "bridge/dds/endpoint.hpp"
#include "tests/bridge/dds_domain.hpp"
#include "tests/bridge/golden_messages.hpp"
#include "tests/bridge/scripted_daemon.hpp"
#include "tests/sim/demo/child_process.hpp"

namespace holdfast::bridge::dds {
namespace {

namespace fs = std::filesystem;

template <class... M>
struct List {
  template <class F>
  static void for_each(F&& f) {
    (f.template operator()<M>(), ...);
  }
};
using All = List<msg::CompensatedPose, msg::MotionStop, msg::TrackingHealth, msg::RegistrationInfo,
                 msg::RobotStatus, msg::OperatorCommand, msg::GuardPermission>;

template <class M>
M golden_message() {
  M message = numbered<M>();
  message.protection.crc32c = canonical_crc(message);
  return message;
}

template <class M>
const Golden& golden_of() {
  return golden().at(TypeNames::GetName<M>(0));
}

template <class M>
Writer<M> make_writer(const Participant& participant) {
  if constexpr (std::same_as<M, msg::CompensatedPose>)
    return Writer<M>(participant, PoseForger::key());
  else
    return Writer<M>(participant);
}

class FastDds : public ::testing::Test {
 protected:
  void TearDown() override { fs::remove(log_); }

  /// Fast DDS on our domain; `last` gives the last word for each message type.
  template <class F>
  sim::ChildProcess start(F&& last) const {
    std::vector<std::string> words{std::to_string(domain_)};
    All::for_each([&]<class M>() {
      words.insert(words.end(), {Topic<M>::policy().name, Topic<M>::descriptor().m_typename,
                                 "best_effort", last.template operator()<M>()});
    });
    return {HOLDFAST_FASTDDS_PEER, words, log_};
  }
  [[nodiscard]] std::string said() const {
    std::ostringstream text;
    text << std::ifstream(log_).rdbuf();
    return text.str();
  }
  /// The newest payload heard on a topic, in hex; empty when there is none.
  [[nodiscard]] std::string heard(const std::string& topic) const {
    const std::string text = said();
    const auto at = text.rfind(topic + " ");
    const auto end = at == std::string::npos ? at : text.find('\n', at);
    return end == std::string::npos
               ? ""
               : text.substr(at + topic.size() + 1, end - at - topic.size() - 1);
  }

  const std::uint32_t domain_ = test_domain() < 99 ? test_domain() + 1 : test_domain() - 1;
  // Fast DDS knows nothing of our discovery tag.
  const Participant participant_{
      {.domain = domain_, .configuration = "file://" HOLDFAST_LOOPBACK_CONFIG}};
  const fs::path log_ =
      fs::temp_directory_path() / ("holdfast-fastdds-" + std::to_string(::getpid()) + ".log");
};

TEST_F(FastDds, ReadsTheGoldenBytesOfEveryTopic) {
  RecordProperty("requirement", "SR-48");
  const auto peer = start([]<class M>() { return std::string("volatile"); });
  All::for_each([&]<class M>() {
    const Writer<M> writer = make_writer<M>(participant_);
    const std::string topic = Topic<M>::policy().name;
    ASSERT_TRUE(eventually([&] {
      (void)writer.write(golden_message<M>());
      return !heard(topic).empty();
    })) << topic
        << said();
    const std::string bytes = heard(topic), wanted = golden_of<M>().cdr;
    // Behind the last field the payload is filled up to four bytes, as its header's last bits say.
    ASSERT_GE(bytes.size(), wanted.size()) << topic;
    EXPECT_LT(bytes.size() - wanted.size(), 8U) << topic;
    EXPECT_EQ(bytes.substr(0, 4), "0001") << topic;
    EXPECT_EQ(bytes.substr(8, wanted.size() - 8), wanted.substr(8)) << topic;
  });
}

TEST_F(FastDds, WritesEveryTopicForOurReaders) {
  RecordProperty("requirement", "SR-48");
  const auto peer = start([]<class M>() { return "=" + golden_of<M>().cdr; });
  All::for_each([&]<class M>() {
    Reader<M> reader(participant_);
    M got{};
    ASSERT_TRUE(eventually([&] {
      const auto messages = reader.take();
      if (!messages.empty()) got = messages.front();
      return !messages.empty();
    })) << Topic<M>::policy().name
        << said();
    EXPECT_EQ(hex(CanonicalBytes<M>(got).bytes()), golden_of<M>().bytes);
    EXPECT_EQ(got.protection.crc32c, canonical_crc(got)) << Topic<M>::policy().name;
  });
}

}  // namespace
}  // namespace holdfast::bridge::dds
