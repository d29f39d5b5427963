// SPDX-License-Identifier: Apache-2.0
#include "rt/recording_file.hpp"

#include <string>

#include "rt/recording_fields.hpp"

namespace holdfast::rt {
namespace {

namespace ros2 = bridge::ros2;

std::string names_of(safety::ReasonSet reasons) {
  std::string names;
  while (!reasons.empty()) {
    const safety::Reason reason = reasons.primary();
    reasons.erase(reason);
    names += (names.empty() ? "" : " ") + std::string(safety::name(reason));
  }
  return names;
}

RecordedLog log_line(const safety::Decision& decision, std::chrono::nanoseconds utc) {
  constexpr std::uint8_t kWarning = 30;
  const std::chrono::seconds whole = std::chrono::floor<std::chrono::seconds>(utc);
  RecordedLog log;
  log.stamp = {static_cast<std::int32_t>(whole.count()),
               static_cast<std::uint32_t>((utc - whole).count())};
  log.name = "gate";
  log.text = std::string(safety::name(decision.mode));
  if (decision.mode == safety::Mode::stop_latched) {
    log.level = kWarning;
    log.text += " " + std::to_string(decision.stop_id);
  }
  if (decision.cause != safety::Reason::none)
    log.text += ": " + std::string(safety::name(decision.cause));
  log.text += "; present: " + names_of(decision.reasons);
  return log;
}

}  // namespace

template <typename T>
RecordingFile::Topic RecordingFile::add_topic(std::string_view topic) {
  const std::uint16_t schema =
      mcap_.add_schema(ros2::schema_name<T>(), "ros2msg", ros2::schema_text<T>());
  return {mcap_.add_channel(schema, topic, "cdr"), 0};
}

template <typename T>
void RecordingFile::write(Topic& topic, safety::Timestamp t, const T& value) {
  ros2::to_cdr(value, bytes_);
  mcap_.message(topic.channel, topic.sequence++, t + utc_minus_monotonic_, bytes_);
}

RecordingFile::RecordingFile(const RecordedSession& session,
                             const std::optional<RecordedRegistration>& registration)
    : mcap_("holdfast " + session.version),
      utc_minus_monotonic_(session.utc_minus_monotonic_ns),
      session_(add_topic<RecordedSession>(kSessionTopic)),
      registration_(add_topic<RecordedRegistration>(kRegistrationTopic)),
      state_(add_topic<TapedState>(kStateTopic)),
      input_(add_topic<RecordedInput>(kInputTopic)),
      decision_(add_topic<RecordedDecision>(kDecisionTopic)),
      gap_(add_topic<RecordedGap>(kGapTopic)),
      log_(add_topic<RecordedLog>(kLogTopic)) {
  const safety::Timestamp t_begun = session.t_begun;
  write(session_, t_begun, session);
  if (registration) add(*registration, t_begun);
}

void RecordingFile::add(const RecordedRegistration& registration, safety::Timestamp t) {
  write(registration_, t, registration);
}
void RecordingFile::add(const RecordedGap& gap, safety::Timestamp t) {
  write(gap_, t, gap);
}
void RecordingFile::add(const TapedState& state, safety::Timestamp t) {
  write(state_, t, state);
}

void RecordingFile::add(const TapedCycle& cycle) {
  const safety::Timestamp t = cycle.t_decided;
  write(input_, t, recorded_input(cycle));
  write(decision_, t, recorded_decision(cycle.info.index, cycle.output));
  if (cycle.output.decision.changed)
    write(log_, t, log_line(cycle.output.decision, t + utc_minus_monotonic_));
}

}  // namespace holdfast::rt
