// SPDX-License-Identifier: Apache-2.0
// A replay finds every change of what was recorded, says what it could not compare, and refuses
// what is damaged or of another version.
#include "rt/replay.hpp"

#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <random>
#include <string>

#include <gtest/gtest.h>
#include <unistd.h>

#include "bridge/recorder/mcap_reader.hpp"
#include "bridge/recorder/mcap_writer.hpp"
#include "rt/core/error.hpp"
#include "rt/recording_fields.hpp"
#include "rt/recording_file.hpp"
#include "tests/rt/recorded_day.hpp"

namespace holdfast::rt {
namespace {

namespace fs = std::filesystem;
namespace mcap = bridge::mcap;
namespace ros2 = bridge::ros2;
using testing::RecordedDay;

/// Which cycles of a day a recording lacks, and from which on a state is in it again.
struct Lacks {
  std::uint64_t from = ~std::uint64_t{0}, to = 0, state_after = 0;
  [[nodiscard]] bool has(std::uint64_t cycle) const { return cycle >= from && cycle < to; }
};

/// A day as the recorder writes it, chunks of 500 cycles. `ends`: the file's size after each.
std::string day_bytes(std::uint64_t cycles, const Lacks& lacks = {},
                      std::vector<std::size_t>* ends = nullptr) {
  RecordingFile file(testing::day_session(), std::nullopt);
  std::string bytes;
  const auto flush = [&] {
    file.mcap().end_chunk();
    bytes += file.mcap().pending();
    file.mcap().clear_pending();
    if (ends != nullptr) ends->push_back(bytes.size());
  };
  RecordedDay day;
  safety::RegistrationInput registration;
  for (std::uint64_t i = 0; i < cycles; ++i)
    day.cycle([&](const CycleInfo& info, safety::Timestamp now, const Readings& readings,
                  const ControlOutput& output, const ControlState& state) {
      if (lacks.has(i)) return;
      if (i == 0 || readings.registration.zoom != registration.zoom) {
        registration = readings.registration;
        file.add(RecordedRegistration{i, registration}, now);
      }
      file.add(TapedCycle{info, now, now, readings, output});
      if (i % 1000 == 999 || (lacks.to > 0 && i == lacks.state_after))
        file.add(TapedState{i, state}, now);
      if (i % 500 == 499) flush();
    });
  file.mcap().finish();
  return bytes + file.mcap().pending();
}

class ReplayTest : public ::testing::Test {
 protected:
  void TearDown() override { fs::remove(file_); }
  [[nodiscard]] ReplayReport replay_bytes(const std::string& bytes) const {
    std::ofstream(file_, std::ios::binary | std::ios::trunc) << bytes;
    return replay({file_});
  }
  /// The same file, every CRC right, with messages as `edit` leaves them.
  [[nodiscard]] std::string edited(
      const std::string& bytes,
      const std::function<void(const std::string& topic, std::string& data)>& edit) const {
    std::ofstream(file_, std::ios::binary | std::ios::trunc) << bytes;
    mcap::Reader reader(file_);
    mcap::Writer writer("edited");
    std::map<std::string, std::uint16_t> channels;
    std::string out;
    mcap::Message message;
    while (reader.next(message)) {
      const mcap::Channel& channel = *message.channel;
      if (!channels.contains(channel.topic)) {
        writer.end_chunk();
        channels[channel.topic] = writer.add_channel(
            writer.add_schema(channel.schema.name, channel.schema.encoding, channel.schema.text),
            channel.topic, channel.encoding);
      }
      std::string data(message.data);
      edit(channel.topic, data);
      writer.message(channels[channel.topic], message.sequence,
                     std::chrono::nanoseconds(message.t_log_ns), data);
    }
    writer.finish();
    return writer.pending();
  }
  /// One field of the input of one cycle is another.
  template <typename Change>
  [[nodiscard]] std::string with_changed_input(const std::string& bytes, std::uint64_t cycle,
                                               Change change) const {
    return edited(bytes, [&](const std::string& topic, std::string& data) {
      if (topic != kInputTopic) return;
      RecordedInput input;
      ASSERT_TRUE(ros2::from_cdr(std::string(data), input));
      if (input.cycle != cycle) return;
      change(input);
      ros2::to_cdr(input, data);
    });
  }
  fs::path file_ = fs::path(::testing::TempDir()) / ("replay-test-" + std::to_string(getpid()));
};

TEST_F(ReplayTest, ReproducesEveryDecisionOfADay) {
  RecordProperty("requirement", "SR-122");
  const ReplayReport report = replay_bytes(day_bytes(RecordedDay::kDay));
  EXPECT_EQ(report.compared, RecordedDay::kDay);
  EXPECT_EQ(report.states, RecordedDay::kDay / 1000);
  EXPECT_EQ(report.differences, 0U);
  EXPECT_EQ(report.recorded, std::chrono::milliseconds(RecordedDay::kDay - 1));
}

TEST_F(ReplayTest, FindsOneBitOfAnEstimateThatIsAnother) {
  const std::string day = day_bytes(1500);
  std::uint64_t cycle = 0;
  (void)edited(day, [&](const std::string& topic, std::string& data) {
    if (topic != kInputTopic || cycle != 0) return;
    RecordedInput input;
    ASSERT_TRUE(ros2::from_cdr(data, input));
    if (input.cycle > 1000 && input.readings.estimate) cycle = input.cycle;
  });
  ASSERT_GT(cycle, 1000U);
  const ReplayReport report = replay_bytes(with_changed_input(day, cycle, [](RecordedInput& input) {
    double& x = input.readings.estimate->motion.T_camera_site.translation().x();
    x = std::nextafter(x, 1e9);
  }));
  EXPECT_EQ(report.compared, 1500U);
  EXPECT_GT(report.differences, 0U);
  ASSERT_TRUE(report.first_difference.has_value());
  EXPECT_EQ(report.first_difference->cycle, cycle);
  EXPECT_NE(report.first_difference->field.find("transform"), std::string::npos)
      << report.first_difference->field;
  EXPECT_NE(report.first_difference->recorded, report.first_difference->replayed);
}

TEST_F(ReplayTest, FindsAChangeOfEachKindOfInput) {
  RecordProperty("requirement", "SR-122");
  const std::string day = day_bytes(1200);
  const std::map<std::string, std::function<void(RecordedInput&)>> changes = {
      {"time", [](RecordedInput& input) { input.t_decided += std::chrono::nanoseconds(1); }},
      {"operator",
       [](RecordedInput& input) {
         input.readings.operator_command = {safety::Command::stop, 0};
       }},
      {"robot", [](RecordedInput& input) { input.readings.robot_status->has_fault = true; }},
      {"loop", [](RecordedInput& input) { input.readings.loop.second_publisher = true; }},
      {"camera", [](RecordedInput& input) {
         FrameArrival arrival;
         arrival.is_connected = false;
         input.readings.arrivals[0] = arrival;
         input.readings.arrival_count = 1;
       }}};
  for (const auto& [name, change] : changes) {
    const ReplayReport report = replay_bytes(with_changed_input(day, 1100, change));
    ASSERT_TRUE(report.first_difference.has_value()) << name;
    EXPECT_EQ(report.first_difference->cycle, 1100U) << name;
  }
}

TEST_F(ReplayTest, FindsAChangedDecisionStateRegistrationAndLimit) {
  const std::string day = day_bytes(1200);
  const auto flip_last_byte_of = [&](std::string_view wanted) {
    return edited(day, [&, is_done = false](const std::string& topic, std::string& data) mutable {
      if (topic != wanted || is_done) return;
      is_done = true;
      data[data.size() - 2] = static_cast<char>(data[data.size() - 2] ^ 1);
    });
  };
  for (const std::string_view topic : {kDecisionTopic, kStateTopic}) {
    const ReplayReport report = replay_bytes(flip_last_byte_of(topic));
    EXPECT_GT(report.differences, 0U) << topic;
  }
  const ReplayReport limits =
      replay_bytes(edited(day, [](const std::string& topic, std::string& data) {
        if (topic != kSessionTopic) return;
        RecordedSession session;
        ASSERT_TRUE(ros2::from_cdr(std::string(data), session));
        session.parameters.limits.sigma_target_max_mm = 0.001;
        ros2::to_cdr(session, data);
      }));
  EXPECT_GT(limits.differences, 0U);
  const ReplayReport registration =
      replay_bytes(edited(day, [](const std::string& topic, std::string& data) {
        if (topic != kRegistrationTopic) return;
        RecordedRegistration recorded;
        ASSERT_TRUE(ros2::from_cdr(std::string(data), recorded));
        recorded.registration.p_target_site_mm.x() += 1;
        ros2::to_cdr(recorded, data);
      }));
  EXPECT_GT(registration.differences, 0U);
}

TEST_F(ReplayTest, ReportsAGapAndGoesOnFromTheNextState) {
  const ReplayReport report = replay_bytes(day_bytes(5000, {1200, 1300, 1305}));
  EXPECT_EQ(report.differences, 0U);
  EXPECT_EQ(report.missing, 100U);
  ASSERT_EQ(report.gaps.size(), 1U);
  EXPECT_EQ(report.gaps[0].first_cycle, 1200U);
  EXPECT_EQ(report.gaps[0].count, 100U);
  EXPECT_EQ(report.without_state, 6U);  // 1300 to 1305
  EXPECT_EQ(report.compared, 5000U - 100 - 6);
}

TEST_F(ReplayTest, ReplaysTheWholePartOfAFileThatWasCutOff) {
  std::vector<std::size_t> ends;
  const std::string day = day_bytes(3000, {}, &ends);
  const std::size_t size = ends[3] + 1234;
  const ReplayReport report = replay_bytes(day.substr(0, size));
  EXPECT_EQ(report.compared, 2000U);
  EXPECT_EQ(report.differences, 0U);
  ASSERT_EQ(report.cuts.size(), 1U);
  EXPECT_EQ(report.cuts[0].at_byte + report.cuts[0].bytes, size);
}

TEST_F(ReplayTest, RefusesAnotherVersionAndAnotherProgramsRecording) {
  const std::string day = day_bytes(100);
  std::string other = day;
  for (std::size_t at = 0; (at = other.find("sigma_target_max_mm", at)) != std::string::npos; ++at)
    other[at] = 'S';
  // Past the CRCs of a closed file: without its end.
  other.resize(other.size() - 1);
  try {
    (void)replay_bytes(other);
    FAIL() << "accepted";
  } catch (const InputError& error) {
    EXPECT_NE(std::string(error.what()).find("another version"), std::string::npos) << error.what();
  }
  mcap::Writer writer("x");
  const auto channel = writer.add_channel(writer.add_schema("a/B", "ros2msg", ""), "/tf", "cdr");
  writer.message(channel, 0, std::chrono::seconds(1), "x");
  writer.finish();
  EXPECT_THROW((void)replay_bytes(writer.pending()), InputError);
}

TEST_F(ReplayTest, NoContentOfAMessageMakesItFailOtherwise) {
  const std::string day = day_bytes(60);
  std::mt19937 random(1);
  for (int run = 0; run < 200; ++run) {
    const std::string bad = edited(day, [&](const std::string& /*topic*/, std::string& data) {
      if (random() % 40 != 0) return;
      if (random() % 3 == 0) data.resize(random() % (data.size() + 20));
      for (unsigned edits = random() % 4; edits > 0 && !data.empty(); --edits)
        data[random() % data.size()] = static_cast<char>(random());
    });
    try {
      (void)replay_bytes(bad);  // compared or refused: no crash, no other exception
    } catch (const InputError&) {
    }
  }
}

}  // namespace
}  // namespace holdfast::rt
