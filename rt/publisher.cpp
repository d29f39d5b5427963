// SPDX-License-Identifier: Apache-2.0
#include "rt/publisher.hpp"

#include <algorithm>

#include "rt/core/clock.hpp"

namespace holdfast::rt {
namespace {

using namespace std::chrono_literals;
namespace dds = bridge::dds;

constexpr auto kStopPeriod = 5ms;      // MotionStop repeats this often: four in its validity
constexpr auto kHealthPeriod = 100ms;  // TrackingHealth too
constexpr auto kLogPeriod = 1s;
constexpr auto kClaimPeriod = 50ms;  // how often discovery is asked for a second publisher

std::uint32_t whole_us(std::chrono::nanoseconds duration) {
  return static_cast<std::uint32_t>(duration.count() / 1000);
}

}  // namespace

Publisher::Publisher(const DaemonConfig& config, const safety::RegistrationInput& registration,
                     safety::ReasonSet advisories)
    : participant_({.domain = static_cast<std::uint32_t>(config.domain),
                    .configuration = {},
                    .security = config.security.folder.string()}),
      claim_(participant_),
      source_(dds::random_source()),
      poses_(participant_, source_),
      stops_(participant_, source_),
      health_(participant_, source_),
      registrations_(participant_, source_),
      inputs_(participant_),
      p_target_ct_mm_(config.p_target_ct_mm),
      advisories_(advisories) {
  msg::RegistrationInfo info =
      dds::to_message(registration, config.registration.zoom, config.registration.focus_mm,
                      config.registration.ct_identity, config.registration.checksum);
  (void)registrations_.publish(info);
}

void Publisher::run(Mailbox<CycleReport>& reports, StopLatch& withdrawals,
                    Mailbox<StampedEstimate>& estimates, ControlInbox& inbox,
                    const HealthSources& health) {
  // The report first, then the latch: a withdrawal decided before the report is seen with it.
  const bool is_new_report = reports.try_take(report_);
  const std::optional<Stop> withdrawal = withdrawals.take();
  const bool is_approved = report_.output.decision.approved.has_value();
  if (withdrawal && (is_approved || !is_new_report)) publish_overtaken(*withdrawal);
  // A withdrawal that is newer than the report: its pose must not go out any more, nor in a later
  // run, for the report may come after it.
  if (withdrawal) withdrawn_until_ = std::max(withdrawn_until_, withdrawal->sequence);
  const bool is_withdrawn = report_.cycles <= withdrawn_until_;
  if (is_new_report && !(is_approved && is_withdrawn)) publish_decision();
  const bool is_new = estimates.try_take(estimate_);
  if (is_new || monotonic_now() - t_health_published_ >= kHealthPeriod)
    publish_health(estimate_, health);
  receive(inbox);
}

void Publisher::publish_decision() {
  const ControlOutput& output = report_.output;
  const safety::Decision& decision = output.decision;
  // Against what was last sent, not the cycle before: that one may have been overtaken.
  const bool is_changed = decision.mode != sent_mode_ || decision.cause != sent_cause_ ||
                          decision.stop_id != sent_stop_id_;
  // The stop message first: a robot takes no pose that was sent before its permission.
  if (is_changed || monotonic_now() - t_stop_published_ >= kStopPeriod) publish_stop(decision);
  log_decision(decision);
  if (!decision.approved) return;
  dds::PoseOrigin origin;
  origin.frame = output.frame;
  origin.t_exposure = output.t_exposure;
  origin.t_frame_received = output.t_frame_received;
  origin.p_target_robot_mm = decision.approved->T_robot_ct() * p_target_ct_mm_;
  (void)poses_.publish(*decision.approved, origin);  // a loss shows as a skipped counter
}

/// Each change of mode at once; what keeps it from being permitted, once a second.
void Publisher::log_decision(const safety::Decision& decision) {
  const safety::Timestamp now = monotonic_now();
  const bool is_new = decision.mode != logged_.mode || decision.stop_id != logged_.stop_id;
  const bool is_due =
      decision.reasons != logged_.reasons && now - logged_.t >= kLogPeriod && !decision.approved;
  if (!is_new && !is_due) return;
  logged_ = {now, decision.mode, decision.cause, decision.reasons, decision.stop_id};
  (void)log_.try_push(logged_);
}

/// A withdrawal whose own report was overtaken by a newer one (the publisher was late).
void Publisher::publish_overtaken(const Stop& withdrawal) {
  safety::Decision decision = report_.output.decision;
  decision.approved.reset();
  decision.reasons = safety::ReasonSet{withdrawal.reasons};
  decision.cause = decision.reasons.primary();
  if (decision.mode == safety::Mode::permitted) decision.mode = safety::Mode::hold;
  publish_stop(decision);
}

void Publisher::publish_stop(const safety::Decision& decision) {
  msg::MotionStop stop = dds::to_message(decision, report_.t_changed, report_.output.t_evidence);
  (void)stops_.publish(stop);
  t_stop_published_ = monotonic_now();
  sent_mode_ = decision.mode;
  sent_cause_ = decision.cause;
  sent_stop_id_ = decision.stop_id;
}

void Publisher::publish_health(const StampedEstimate& estimate, const HealthSources& sources) {
  dds::HealthFigures figures;
  figures.frame = estimate.frame;
  figures.registration_id = estimate.registration_id;
  figures.sigma_target_mm = report_.output.sigma_target_mm;
  figures.clock_offset_sigma_us = static_cast<double>(sources.clock_sigma.count()) / 1000.0;
  figures.frames_received = sources.frames_received;
  figures.frames_incomplete = sources.frames_incomplete;
  figures.frames_missing = sources.frames_missing;
  figures.frames_skipped = sources.frames_skipped;
  figures.cycles = report_.cycles;
  figures.cycles_missed = report_.cycles_missed;
  figures.wake_lateness_max_us = whole_us(report_.wake_lateness_max);
  figures.step_max_us = whole_us(report_.step_max);
  figures.advisories = advisories_;
  figures.advisories.insert(sources.advisories.with(safety::Severity::advisory));
  msg::TrackingHealth health = dds::to_message(estimate.motion, figures);
  (void)health_.publish(health);
  t_health_published_ = monotonic_now();
}

void Publisher::receive(ControlInbox& inbox) {
  const dds::ReceivedInputs received = inputs_.poll();
  if (received.robot) inbox.robot_status.publish(*received.robot);
  for (const safety::OperatorInput& command : received.commands()) {
    (void)inbox.commands.try_push(command);  // overflow is counted; the control cycle sees it
    using safety::Command;
    if (command.command == Command::acknowledge || command.command == Command::arm)
      inbox.optics.recovery.store(true, std::memory_order_relaxed);
  }
  if (received.is_corrupt) inbox.message_corrupt.store(true, std::memory_order_relaxed);
  const safety::Timestamp now = monotonic_now();
  if (now - t_claim_checked_ < kClaimPeriod) return;
  t_claim_checked_ = now;
  inbox.second_publisher.store(claim_.second_publisher(), std::memory_order_relaxed);
}

void Publisher::publish_end() {
  safety::Decision decision = report_.output.decision;
  decision.approved.reset();
  decision.mode = safety::Mode::init;
  decision.cause = safety::Reason::initialising;
  decision.reasons = safety::ReasonSet{};
  decision.reasons.insert(decision.cause);
  publish_stop(decision);
}

}  // namespace holdfast::rt
