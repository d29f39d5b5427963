// SPDX-License-Identifier: Apache-2.0
#include "rt/daemon_recorder.hpp"

#include <cstring>

#include <spdlog/spdlog.h>

namespace holdfast::rt {
namespace {

RecordedSession session_of(const DaemonConfig& config, const ControlParameters& parameters) {
  RecordedSession session;
  session.version = HOLDFAST_VERSION;
  session.run = static_cast<std::uint64_t>(utc_now().count());
  session.utc_minus_monotonic_ns = (utc_now() - monotonic_now()).count();
  session.loop_period = config.loop.period;
  session.registration_checksum = config.registration.checksum;
  session.ct = config.registration.ct_identity;
  session.zoom = config.registration.zoom;
  session.focus_mm = config.registration.focus_mm;
  session.p_target_ct_mm = config.p_target_ct_mm;
  session.parameters = parameters;
  return session;
}

}  // namespace

DaemonRecorder::DaemonRecorder(const DaemonConfig& config, const ControlParameters& parameters) {
  if (!config.recorder) return;
  recorder_ = std::make_unique<Recorder>(*config.recorder, session_of(config, parameters));
  spdlog::info("recording to {}, at most {} MB", config.recorder->folder.string(),
               config.recorder->size_max_bytes / 1'000'000);
}

safety::ReasonSet DaemonRecorder::advisories() const noexcept {
  safety::ReasonSet advisories;
  if (recorder_ && recorder_->status().condition != RecorderCondition::recording)
    advisories.insert(safety::Reason::not_recording);
  return advisories;
}

void DaemonRecorder::log_changes() {
  if (!recorder_) return;
  constexpr std::chrono::seconds kLogPeriod{1};
  const RecorderStatus status = recorder_->status();
  const std::chrono::nanoseconds now = monotonic_now();
  const bool is_new = status.condition != logged_.condition;
  const bool is_due = status.lost != logged_.lost && now - t_logged_ >= kLogPeriod;
  if (!is_new && !is_due) return;
  logged_ = status;
  t_logged_ = now;
  if (status.condition == RecorderCondition::recording)
    spdlog::info("recording; {} cycles lost so far", status.lost);
  else
    spdlog::warn("not recording: {}: {}; {} cycles lost so far", name(status.condition),
                 std::strerror(status.error), status.lost);
}

}  // namespace holdfast::rt
