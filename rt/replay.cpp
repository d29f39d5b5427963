// SPDX-License-Identifier: Apache-2.0
#include "rt/replay.hpp"

#include <algorithm>
#include <atomic>
#include <cstring>
#include <exception>
#include <map>
#include <mutex>
#include <string_view>
#include <thread>
#include <utility>

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

/// One file, on its own: it begins in the initial state or with a recorded one.
class FileReplay {
 public:
  FileReplay(const std::filesystem::path& file, const ReplayWatch& watch)
      : watch_(watch), file_(file) {}
  void run();
  /// `before` was recorded just before this file, perhaps in the same run: does it lead here?
  void join(const FileReplay& before);
  /// Adds what was found to a report on all files.
  void add_to(ReplayReport& report) const;

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
  void note_gap(std::uint64_t end);
  template <typename T>
  void compare(std::uint64_t cycle, const T& replayed, std::string_view recorded);

  ReplayReport report_;
  const ReplayWatch& watch_;
  std::filesystem::path file_;
  std::map<const mcap::Channel*, Topic> topics_;  // of the open file

  std::optional<RecordedSession> session_;
  bool continues_run_ = false;
  std::optional<std::uint64_t> first_cycle_;
  std::string first_state_;  // the bytes of the state message that the file begins with
  RecordedRegistration registration_;
  bool has_registration_ = false;
  ControlState state_;
  bool has_state_ = false;  // state_ is what next_cycle_ starts from
  std::uint64_t next_cycle_ = 0;
  RecordedInput input_;
  bool has_input_ = false;
  std::chrono::nanoseconds t_first_{}, t_last_{};
  TapedState recorded_state_;
  std::string bytes_;
};

void FileReplay::run() {
  mcap::Reader reader(file_);
  mcap::Message message;
  while (reader.next(message)) {
    auto known = topics_.find(message.channel);
    if (known == topics_.end())
      known = topics_.emplace(message.channel, topic_of(*message.channel)).first;
    if (!session_ && known->second != Topic::session)
      fail("does not begin with a session: not a recording of holdfastd");
    take(known->second, message);
  }
  ++report_.files;
  if (!reader.is_closed())
    report_.cuts.push_back(
        {file_, reader.file_bytes() - reader.bytes_cut_off(), reader.bytes_cut_off()});
}

template <typename T>
void FileReplay::require_schema(const mcap::Channel& channel) const {
  if (channel.encoding == "cdr" && channel.schema.encoding == "ros2msg" &&
      channel.schema.name == ros2::schema_name<T>() &&
      channel.schema.text == ros2::schema_text<T>())
    return;
  fail(fmt::format("{} is of another version of Holdfast: replay it with the version that made it",
                   channel.topic));
}

FileReplay::Topic FileReplay::topic_of(const mcap::Channel& channel) {
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
void FileReplay::decode(const mcap::Message& message, T& value) const {
  if (!ros2::from_cdr(message.data, value))
    fail(fmt::format("a message on {} after cycle {} that cannot be read: damaged",
                     message.channel->topic, next_cycle_));
}

void FileReplay::take(Topic topic, const mcap::Message& message) {
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

void FileReplay::take_session(const mcap::Message& message) {
  RecordedSession session;
  decode(message, session);
  if (session_) fail("a second session: damaged");
  session_ = session;
  if (session.part > 0) return;
  has_state_ = true;  // the initial one
  first_cycle_ = 0;
}

void FileReplay::take_state(const mcap::Message& message) {
  decode(message, recorded_state_);
  const std::uint64_t next = recorded_state_.after + 1;
  if (!first_cycle_) {
    first_state_ = message.data;
    first_cycle_ = next_cycle_ = next;
  } else if (has_state_ && next == next_cycle_) {
    ++report_.states;
    compare(recorded_state_.after, TapedState{recorded_state_.after, state_}, message.data);
  }
  go_on_at(next);
  state_ = recorded_state_.state;
  has_state_ = true;
}

/// Whatever lies between the newest cycle and this one is missing, and with it the state.
void FileReplay::go_on_at(std::uint64_t cycle) {
  if (cycle == next_cycle_) return;
  if (cycle < next_cycle_) fail(fmt::format("cycle {} comes twice: damaged", cycle));
  note_gap(cycle);
  has_state_ = false;
  next_cycle_ = cycle;
}

void FileReplay::note_gap(std::uint64_t end) {
  report_.missing += end - next_cycle_;
  if (report_.gaps.size() < ReplayReport::kGapsMax)
    report_.gaps.push_back({next_cycle_, end - next_cycle_});
}

void FileReplay::take_input(const mcap::Message& message) {
  decode(message, input_);
  has_input_ = true;
  if (++report_.cycles == 1) t_first_ = input_.t_decided;
  t_last_ = input_.t_decided;
}

void FileReplay::take_decision(const mcap::Message& message) {
  if (!has_input_ || !has_registration_) fail("a decision without its input: damaged");
  has_input_ = false;
  const std::uint64_t cycle = input_.cycle;
  if (!first_cycle_) first_cycle_ = next_cycle_ = cycle;
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
void FileReplay::compare(std::uint64_t cycle, const T& replayed, std::string_view recorded) {
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

/// What the file before left must be what this one begins with: cycle by cycle and bit by bit.
void FileReplay::join(const FileReplay& before) {
  if (!session_ || !before.session_ || session_->run != before.session_->run) return;
  continues_run_ = true;
  if (!first_cycle_ || !before.first_cycle_) return;
  const std::uint64_t expected = before.next_cycle_;
  if (*first_cycle_ < expected) fail(fmt::format("cycle {} comes twice: damaged", *first_cycle_));
  if (*first_cycle_ > expected) {
    report_.missing += *first_cycle_ - expected;
    report_.gaps.insert(report_.gaps.begin(), {expected, *first_cycle_ - expected});
    return;
  }
  if (first_state_.empty() || !before.has_state_) return;
  ++report_.states;
  const auto later = std::exchange(report_.first_difference, std::nullopt);
  compare(expected - 1, TapedState{expected - 1, before.state_}, first_state_);
  if (!report_.first_difference) report_.first_difference = later;
}

void FileReplay::add_to(ReplayReport& report) const {
  report.files += report_.files;
  if (session_ && !continues_run_) ++report.runs;
  report.cycles += report_.cycles;
  report.compared += report_.compared;
  report.states += report_.states;
  report.without_state += report_.without_state;
  report.differences += report_.differences;
  report.missing += report_.missing;
  for (const RecordedGap& gap : report_.gaps)
    if (report.gaps.size() < ReplayReport::kGapsMax) report.gaps.push_back(gap);
  report.cuts.insert(report.cuts.end(), report_.cuts.begin(), report_.cuts.end());
  if (!report.first_difference) report.first_difference = report_.first_difference;
  report.recorded += t_last_ - t_first_;
}

/// Every file, as many at a time as there are processors; the first file's failure is thrown.
void run_all(std::vector<FileReplay>& replays, const std::vector<std::filesystem::path>& files,
             const ReplayWatch& watch) {
  std::vector<std::exception_ptr> failures(replays.size());
  std::atomic<std::size_t> next{0};
  std::mutex mutex;  // of on_file
  const auto work = [&] {
    for (std::size_t i = next++; i < replays.size(); i = next++) {
      try {
        if (watch.on_file) {
          const std::lock_guard lock(mutex);
          watch.on_file(files[i]);
        }
        replays[i].run();
      } catch (...) {
        failures[i] = std::current_exception();
      }
    }
  };
  const std::size_t workers =
      watch.on_cycle ? 1
                     : std::min<std::size_t>(replays.size(), std::thread::hardware_concurrency());
  {
    std::vector<std::jthread> others;
    for (std::size_t i = 1; i < workers; ++i) others.emplace_back(work);
    work();
  }
  for (const std::exception_ptr& failure : failures)
    if (failure) std::rethrow_exception(failure);
}

}  // namespace

ReplayReport replay(const std::vector<std::filesystem::path>& files, const ReplayWatch& watch) {
  std::vector<FileReplay> replays;
  replays.reserve(files.size());
  for (const std::filesystem::path& file : files) replays.emplace_back(file, watch);
  run_all(replays, files, watch);
  ReplayReport report;
  for (std::size_t i = 0; i < replays.size(); ++i) {
    if (i > 0) replays[i].join(replays[i - 1]);
    replays[i].add_to(report);
  }
  return report;
}

}  // namespace holdfast::rt
