// SPDX-License-Identifier: Apache-2.0
// The publishing thread's work: what the control loop decided goes out over DDS, what robot and
// operator say comes in. The control thread never touches DDS.
#pragma once

#include <cstdint>

#include "bridge/dds/daemon_claim.hpp"
#include "bridge/dds/inputs.hpp"
#include "bridge/dds/messages.hpp"
#include "rt/control_cycle.hpp"
#include "rt/core/event_queue.hpp"
#include "rt/daemon_config.hpp"

namespace holdfast::rt {

/// A change worth a line in the log.
struct LogEvent {
  safety::Timestamp t{};
  safety::Mode mode = safety::Mode::init;
  safety::Reason cause = safety::Reason::none;
  safety::ReasonSet reasons;
  std::uint32_t stop_id = 0;
};

/// Counters that live outside the control loop and travel with each health message.
struct HealthSources {
  std::uint64_t frames_received = 0, frames_incomplete = 0, frames_missing = 0, frames_skipped = 0;
  std::chrono::nanoseconds clock_sigma{};
  safety::ReasonSet advisories;  ///< that come and go, beside those known at the start
};

class Publisher {
 public:
  using Log = EventQueue<LogEvent, 256>;

  /// Claims the domain and announces the registration. Throws InputError when the domain already
  /// has a daemon, UnavailableError when DDS is not there.
  Publisher(const DaemonConfig& config, const safety::RegistrationInput& registration,
            safety::ReasonSet advisories);

  /// One period, after the control cycle. Publishing thread only.
  void run(Mailbox<CycleReport>& reports, StopLatch& withdrawals,
           Mailbox<StampedEstimate>& estimates, ControlInbox& inbox, const HealthSources& health);

  /// The last message of a daemon that ends on purpose: not permitted. After run() has ended.
  void publish_end();

  /// Read by one other thread.
  [[nodiscard]] Log& log() noexcept { return log_; }

 private:
  void publish_decision();
  void publish_overtaken(const Stop& withdrawal);
  void publish_health(const StampedEstimate& estimate, const HealthSources& health);
  void receive(ControlInbox& inbox);
  void log_decision(const safety::Decision& decision);
  void publish_stop(const safety::Decision& decision);

  bridge::dds::Participant participant_;
  bridge::dds::DaemonClaim claim_;
  std::uint32_t source_;
  bridge::dds::PosePublisher poses_;
  bridge::dds::ProtectedWriter<msg::MotionStop> stops_;
  bridge::dds::ProtectedWriter<msg::TrackingHealth> health_;
  bridge::dds::ProtectedWriter<msg::RegistrationInfo> registrations_;
  bridge::dds::InputReader inputs_;

  Eigen::Vector3d p_target_ct_mm_;
  safety::ReasonSet advisories_;
  CycleReport report_;
  std::uint64_t withdrawn_until_ = 0;  ///< cycle of the newest withdrawal
  StampedEstimate estimate_;
  safety::Mode sent_mode_ = safety::Mode::init;  // of the newest MotionStop sent
  safety::Reason sent_cause_ = safety::Reason::none;
  std::uint32_t sent_stop_id_ = 0;
  LogEvent logged_;
  safety::Timestamp t_stop_published_{};
  safety::Timestamp t_health_published_{};
  safety::Timestamp t_claim_checked_{};
  Log log_;
};

}  // namespace holdfast::rt
