// SPDX-License-Identifier: Apache-2.0
#include "rt/replay.hpp"

#include <algorithm>
#include <cstring>
#include <map>
#include <string_view>

#include <fmt/format.h>

#include "bridge/recorder/mcap_reader.hpp"
#include "rt/core/error.hpp"
#include "rt/recording_fields.hpp"

namespace holdfast::rt {
namespace {

namespace mcap = bridge::mcap;
namespace ros2 = bridge::ros2;

template <typename W>
std::string text_of(std::string_view bytes) {
  W value{};
  std::memcpy(&value, bytes.data(), sizeof(W));
  if constexpr (std::is_same_v<W, std::uint8_t>) return fmt::format("{}", unsigned{value});
  return fmt::format("{}", value);
}

/// The value of a field in a message; a difference that no decimal shows still shows in hex.
std::string value_at(const ros2::FieldPlace& place, std::string_view message) {
  if (place.offset + place.size > message.size()) return "nothing";
  const std::string_view bytes = message.substr(place.offset, place.size);
  const std::string_view type = place.type;
  if (type == "float64") return text_of<double>(bytes);
  if (type == "int64") return text_of<std::int64_t>(bytes);
  if (type == "uint64") return text_of<std::uint64_t>(bytes);
  if (type == "int32") return text_of<std::int32_t>(bytes);
  if (type == "uint32") return text_of<std::uint32_t>(bytes);
  return text_of<std::uint8_t>(bytes);
}

class Replayer {
 public:
  Replayer(ReplayReport& report, const ReplayWatch& watch) : report_(report), watch_(watch) {}
  void read(const std::filesystem::path& file);

 private:
  enum class Topic { session, registration, state, input, decision, gap, log };
  [[noreturn]] void fail(const std::string& what) const {
    throw InputError(fmt::format("{}: {}", file_.string(), what));
  }
  [[nodiscard]] Topic topic_of(const mcap::Channel& channel);
  template <typename T>
  void require_schema(const mcap::Channel& channel) const;
  template <typename T>
  void decode(const mcap::Message& message, T& value) const;
  void take(Topic topic, const mcap::Message& message);
  void take_session(const mcap::Message& message);
  void take_state(const mcap::Message& message);
  void take_input(const mcap::Message& message);
  void take_decision(const mcap::Message& message);
  void go_on_at(std::uint64_t cycle);
  template <typename T>
  void compare(std::uint64_t cycle, const T& replayed, std::string_view recorded);

  ReplayReport& report_;
  const ReplayWatch& watch_;
  std::filesystem::path file_;
  std::map<const mcap::Channel*, Topic> topics_;  // of the open file

  std::optional<RecordedSession> session_;
  bool has_session_in_file_ = false;
  RecordedRegistration registration_;
  bool has_registration_ = false;
  ControlState state_;
  bool has_state_ = false;  // state_ is what next_cycle_ starts from
  std::uint64_t next_cycle_ = 0;
  RecordedInput input_;
  bool has_input_ = false;
  std::optional<std::chrono::nanoseconds> t_previous_;
  TapedState recorded_state_;
  std::string bytes_;
};

void Replayer::read(const std::filesystem::path& file) {
  file_ = file;
  topics_.clear();
  has_session_in_file_ = has_input_ = false;
  mcap::Reader reader(file);
  mcap::Message message;
  while (reader.next(message)) {
    auto known = topics_.find(message.channel);
    if (known == topics_.end())
      known = topics_.emplace(message.channel, topic_of(*message.channel)).first;
    if (!has_session_in_file_ && known->second != Topic::session)
      fail("does not begin with a session: not a recording of holdfastd");
    take(known->second, message);
  }
  ++report_.files;
  if (!reader.is_closed())
    report_.cuts.push_back(
        {file, reader.file_bytes() - reader.bytes_cut_off(), reader.bytes_cut_off()});
}

template <typename T>
void Replayer::require_schema(const mcap::Channel& channel) const {
  if (channel.encoding == "cdr" && channel.schema.encoding == "ros2msg" &&
      channel.schema.name == ros2::schema_name<T>() &&
      channel.schema.text == ros2::schema_text<T>())
    return;
  fail(fmt::format("{} is of another version of Holdfast: replay it with the version that made it",
                   channel.topic));
}

Replayer::Topic Replayer::topic_of(const mcap::Channel& channel) {
  const std::string& topic = channel.topic;
  if (topic == kSessionTopic) return require_schema<RecordedSession>(channel), Topic::session;
  if (topic == kRegistrationTopic)
    return require_schema<RecordedRegistration>(channel), Topic::registration;
  if (topic == kStateTopic) return require_schema<TapedState>(channel), Topic::state;
  if (topic == kInputTopic) return require_schema<RecordedInput>(channel), Topic::input;
  if (topic == kDecisionTopic) return require_schema<RecordedDecision>(channel), Topic::decision;
  if (topic == kGapTopic) return Topic::gap;  // the cycles' numbers say it again
  if (topic == kLogTopic) return Topic::log;
  fail(fmt::format("topic {} is not one of a recording of holdfastd", topic));
}

template <typename T>
void Replayer::decode(const mcap::Message& message, T& value) const {
  if (!ros2::from_cdr(message.data, value))
    fail(fmt::format("a message on {} after cycle {} that cannot be read: damaged",
                     message.channel->topic, next_cycle_));
}

void Replayer::take(Topic topic, const mcap::Message& message) {
  switch (topic) {
    case Topic::session:
      return take_session(message);
    case Topic::registration:
      decode(message, registration_);
      has_registration_ = true;
      return;
    case Topic::state:
      return take_state(message);
    case Topic::input:
      return take_input(message);
    case Topic::decision:
      return take_decision(message);
    case Topic::gap:
    case Topic::log:
      return;
  }
}

/// The files of one run continue each other; a run begins in the initial state.
void Replayer::take_session(const mcap::Message& message) {
  RecordedSession session;
  decode(message, session);
  const bool is_next =
      session_ && session.run == session_->run && session.part == session_->part + 1;
  if (!session_ || session.run != session_->run) {
    ++report_.runs;
    t_previous_.reset();
  }
  if (!is_next) {
    has_registration_ = false;
    state_ = {};
    has_state_ = session.part == 0;
    next_cycle_ = 0;
  }
  session_ = session;
  has_session_in_file_ = true;
}

void Replayer::take_state(const mcap::Message& message) {
  decode(message, recorded_state_);
  if (has_state_ && recorded_state_.after + 1 == next_cycle_) {
    ++report_.states;
    compare(recorded_state_.after, TapedState{recorded_state_.after, state_}, message.data);
  }
  go_on_at(recorded_state_.after + 1);
  state_ = recorded_state_.state;
  has_state_ = true;
}

/// Whatever lies between the newest cycle and this one is missing, and with it the state.
void Replayer::go_on_at(std::uint64_t cycle) {
  if (cycle == next_cycle_) return;
  if (cycle < next_cycle_) fail(fmt::format("cycle {} comes twice: damaged", cycle));
  // The first file of a folder may begin anywhere: its predecessors were deleted, not lost.
  if (has_state_ || next_cycle_ > 0) {
    report_.missing += cycle - next_cycle_;
    if (report_.gaps.size() < ReplayReport::kGapsMax)
      report_.gaps.push_back({next_cycle_, cycle - next_cycle_});
  }
  has_state_ = false;
  next_cycle_ = cycle;
}

void Replayer::take_input(const mcap::Message& message) {
  decode(message, input_);
  has_input_ = true;
  ++report_.cycles;
  if (t_previous_) report_.recorded += input_.t_decided - *t_previous_;
  t_previous_ = input_.t_decided;
}

void Replayer::take_decision(const mcap::Message& message) {
  if (!has_input_ || !has_registration_) fail("a decision without its input: damaged");
  has_input_ = false;
  const std::uint64_t cycle = input_.cycle;
  go_on_at(cycle);
  next_cycle_ = cycle + 1;
  if (!has_state_) {
    ++report_.without_state;
    return;
  }
  input_.readings.registration = registration_.registration;
  const ControlOutput output =
      control_step(input_.t_decided, session_->parameters, input_.readings, state_);
  ++report_.compared;
  compare(cycle, recorded_decision(cycle, output), message.data);
  if (watch_.on_cycle) watch_.on_cycle(input_, output);
  constexpr std::uint64_t kLookEvery = 4096;
  if (report_.compared % kLookEvery == 0 && watch_.is_interrupted && watch_.is_interrupted())
    throw InterruptedError("interrupted");
}

template <typename T>
void Replayer::compare(std::uint64_t cycle, const T& replayed, std::string_view recorded) {
  ros2::to_cdr(replayed, bytes_);
  if (bytes_ == recorded) return;
  ++report_.differences;
  if (report_.first_difference) return;
  const auto parting =
      std::mismatch(bytes_.begin(), bytes_.end(), recorded.begin(), recorded.end());
  const auto at = static_cast<std::size_t>(parting.first - bytes_.begin());
  std::vector<ros2::FieldPlace> places;
  std::string again;
  ros2::to_cdr(replayed, again, &places);
  ReplayDifference difference{file_, cycle, "length", fmt::format("{} bytes", recorded.size()),
                              fmt::format("{} bytes", bytes_.size())};
  for (const ros2::FieldPlace& place : places) {
    if (at >= place.offset + place.size) continue;
    difference.field = place.name;
    difference.recorded = value_at(place, recorded);
    difference.replayed = value_at(place, bytes_);
    break;
  }
  report_.first_difference = difference;
}

}  // namespace

ReplayReport replay(const std::vector<std::filesystem::path>& files, const ReplayWatch& watch) {
  ReplayReport report;
  Replayer replayer(report, watch);
  for (const std::filesystem::path& file : files) {
    if (watch.on_file) watch.on_file(file);
    replayer.read(file);
  }
  return report;
}

}  // namespace holdfast::rt
