// SPDX-License-Identifier: Apache-2.0
#include "rt/guard/guard.hpp"

#include <cstring>

#include <dds/dds.h>
#include <fmt/format.h>
#include <sched.h>
#include <sys/mman.h>

#include "bridge/command_line.hpp"
#include "bridge/dds/endpoint.hpp"
#include "bridge/service.hpp"
#include "rt/core/error.hpp"
#include "rt/guard/watchdog.hpp"

namespace holdfast::guard {
namespace {

using namespace bridge::dds;  // NOLINT(google-build-using-namespace): this file is its user

constexpr nanoseconds kStep = milliseconds(1);
constexpr nanoseconds kPublishPeriod = milliseconds(2);
constexpr nanoseconds kStrokePeriod = milliseconds(100);

void become_real_time(const GuardConfig& config) {
  sched_param priority{};
  priority.sched_priority = config.priority;
  std::string denied;
  if (mlockall(MCL_CURRENT | MCL_FUTURE) != 0)
    denied = fmt::format("memory lock denied: {}", std::strerror(errno));
  if (config.priority > 0 && sched_setscheduler(0, SCHED_FIFO, &priority) != 0)
    denied =
        fmt::format("SCHED_FIFO priority {} denied: {}", config.priority, std::strerror(errno));
  if (denied.empty()) return;
  if (!config.allow_non_rt)
    throw UnavailableError(denied + "; grant it (holdfast doctor tells how) or set allow_non_rt");
  fmt::print(stderr, "guard: not real-time, as allowed: {}\n", denied);
}

/// The guard on the wire.
class GuardLoop {
 public:
  explicit GuardLoop(const GuardConfig& config)
      : config_(config),
        core_(config.limits, config.T_robot_camera),
        watchdog_(config.watchdog_device),
        participant_({.domain = static_cast<std::uint32_t>(config.domain),
                      .configuration = {},
                      .security = config.security.folder.string()}),
        stops_(participant_),
        poses_(participant_),
        health_(participant_),
        registrations_(participant_),
        robot_(participant_),
        answers_(participant_, random_source()),
        waitset_(dds_create_waitset(participant_.handle()), "create a waitset") {
    for (const std::int32_t reader : {stops_.handle(), poses_.handle(), robot_.handle()}) {
      require(dds_set_status_mask(reader, DDS_DATA_AVAILABLE_STATUS), "watch for messages");
      require(dds_waitset_attach(waitset_.handle(), reader, 0), "watch for messages");
    }
  }

  void run() {
    while (!bridge::is_interrupted()) {
      (void)dds_waitset_wait(waitset_.handle(), nullptr, 0, kStep.count());
      drain(registrations_);
      drain(health_);
      drain(stops_);
      drain(poses_);
      drain(robot_);
      const nanoseconds now = read_clocks().monotonic;
      act(core_.decide(now), now);
    }
    GuardAnswer last;
    last.t_changed = read_clocks().monotonic;
    publish(last, last.t_changed);
    (void)answers_.writer().wait_for_acknowledgements(milliseconds(100));
  }

 private:
  template <class M>
  void drain(Reader<M>& reader) {
    reader.drain([this](const M& message, Clocks now) { core_.take(message, now); });
  }

  void act(const GuardAnswer& answer, nanoseconds now) {
    const bool is_change = answer.cause != cause_;
    if (is_change || now - t_published_ >= kPublishPeriod) publish(answer, now);
    if (!answer.may_stroke_watchdog) watchdog_.give_up();
    if (now - t_stroked_ >= kStrokePeriod) {
      watchdog_.stroke();
      bridge::service_is_alive();
      t_stroked_ = now;
    }
    if (is_change)
      fmt::print(stderr, "guard: {}\n", answer.is_permitted ? "permitted" : name(answer.cause));
    cause_ = answer.cause;
  }

  void publish(const GuardAnswer& answer, nanoseconds now) {
    msg::GuardPermission m{};
    m.is_permitted = answer.is_permitted;
    m.cause = static_cast<std::uint8_t>(answer.cause);
    m.daemon_source = answer.daemon_source;
    m.t_changed_ns = answer.t_changed.count();
    if (answers_.publish(m, config_.permission_validity)) t_published_ = now;
  }

  GuardConfig config_;
  GuardCore core_;
  Watchdog watchdog_;
  Participant participant_;
  Reader<msg::MotionStop> stops_;
  Reader<msg::CompensatedPose> poses_;
  Reader<msg::TrackingHealth> health_;
  Reader<msg::RegistrationInfo> registrations_;
  Reader<msg::RobotStatus> robot_;
  ProtectedWriter<msg::GuardPermission> answers_;
  Entity waitset_;
  GuardCause cause_ = GuardCause::none;
  nanoseconds t_published_{}, t_stroked_{};
};

}  // namespace

void run_guard(const GuardConfig& config) {
  GuardLoop loop(config);
  become_real_time(config);  // after the middleware's threads: they stay ordinary
  fmt::print(stderr, "guard: running on domain {}\n", config.domain);
  bridge::service_is_ready();
  loop.run();
  bridge::service_is_ending();
}

}  // namespace holdfast::guard
