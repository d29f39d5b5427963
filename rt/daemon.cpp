// SPDX-License-Identifier: Apache-2.0
#include "rt/daemon.hpp"

#include <atomic>
#include <cstdint>
#include <optional>
#include <string>
#include <system_error>
#include <thread>
#include <vector>

#include <fmt/chrono.h>
#include <opencv2/core/utility.hpp>
#include <spdlog/spdlog.h>

#include "bridge/camera_source.hpp"
#include "bridge/command_line.hpp"
#include "bridge/service.hpp"
#include "rt/control_cycle.hpp"
#include "rt/core/memory_lock.hpp"
#include "rt/daemon_recorder.hpp"
#include "rt/optics_thread.hpp"
#include "rt/publisher.hpp"
#include "rt/tracking_thread.hpp"

namespace holdfast::rt {
namespace {

using namespace std::chrono_literals;

constexpr auto kHousekeepingPeriod = 50ms;

safety::RegistrationInput registration_input(const DaemonConfig& config) {
  safety::RegistrationInput input;
  input.is_loaded = true;
  input.id = config.registration.id();
  input.T_site_ct = config.registration.T_camera_ct;  // site = camera at the keyframe
  input.covariance = config.registration.covariance;
  input.zoom = config.registration.zoom;
  input.focus_mm = config.registration.focus_mm;
  input.p_target_site_mm = input.T_site_ct * config.p_target_ct_mm;
  return input;
}

ControlParameters control_parameters(const DaemonConfig& config, safety::ReasonSet advisories) {
  ControlParameters parameters;
  parameters.limits = config.limits;
  parameters.filter = config.filter;
  parameters.T_robot_camera = config.T_robot_camera;
  parameters.hand_eye_sigma = config.hand_eye_sigma;
  parameters.optics_are_fixed = config.optics.are_fixed;
  parameters.advisories = advisories;
  return parameters;
}

CyclicThreadParameters thread_parameters(const LoopParameters& loop, const char* name, int priority,
                                         std::chrono::nanoseconds phase) {
  CyclicThreadParameters parameters;
  parameters.name = name;
  parameters.period = loop.period;
  parameters.phase = phase;
  parameters.fifo_priority = priority;
  parameters.cpu = loop.control_cpu;
  parameters.allow_non_rt = loop.allow_non_rt;
  return parameters;
}

void warn(const std::vector<std::string>& warnings) {
  for (const std::string& warning : warnings) spdlog::warn("{}", warning);
}

std::string names_of(safety::ReasonSet reasons) {
  std::string names;
  while (!reasons.empty()) {
    const safety::Reason reason = reasons.primary();
    reasons.erase(reason);
    if (safety::severity(reason) == safety::Severity::advisory) continue;
    names += (names.empty() ? "" : " ") + std::string{safety::name(reason)};
  }
  return names;
}

void log_changes(Publisher::Log& log) {
  LogEvent event;
  while (log.try_pop(event)) {
    const std::string reasons = names_of(event.reasons);
    if (event.mode == safety::Mode::stop_latched)
      spdlog::warn("stop {}: {}; present: {}", event.stop_id, safety::name(event.cause), reasons);
    else
      spdlog::info("{}{}{}", safety::name(event.mode), reasons.empty() ? "" : ": ", reasons);
  }
}

/// Real-time scheduling is tried on a thread that does nothing, so that its absence is known, and
/// published, before the first cycle.
safety::ReasonSet probe_real_time(const LoopParameters& loop) {
  safety::ReasonSet advisories;
  MemoryLockParameters memory;
  memory.allow_non_rt = loop.allow_non_rt;
  std::vector<std::string> warnings = lock_memory(memory);
  const CyclicThread probe{thread_parameters(loop, "probe", loop.control_priority, 0ns),
                           [](const CycleInfo&) {}};
  warnings.insert(warnings.end(), probe.warnings().begin(), probe.warnings().end());
  warn(warnings);
  if (!warnings.empty()) advisories.insert(safety::Reason::not_real_time);
  return advisories;
}

/// Says at start what will end the service one day, and what is open to everybody.
safety::ReasonSet look_at_security(const bridge::SecurityConfig& security) {
  safety::ReasonSet advisories;
  if (security.folder.empty()) {
    advisories.insert(safety::Reason::unsecured_transport);
    spdlog::warn("DDS is unsecured: anyone on this network may read and write the topics");
    return advisories;
  }
  constexpr std::chrono::days kNotice{30};
  if (security.valid_until < std::chrono::system_clock::now() + kNotice)
    spdlog::warn("the keys in {} end on {:%Y-%m-%d}; no new connection is made after that",
                 security.folder.string(), security.valid_until);
  return advisories;
}

/// Says at start whether anybody watches zoom and focus.
safety::ReasonSet look_at_optics(const OpticsParameters& optics) {
  if (optics.are_fixed)
    spdlog::warn("zoom and focus are declared fixed: no encoder is read");
  else if (!optics.local.empty())
    spdlog::warn("the microscope is a virtual one on {}: this is no CAN", optics.local.string());
  else
    spdlog::info("microscope: node {} on {}", optics.microscope.node, optics.interface);
  return optics_advisories(optics);
}

}  // namespace

void run_daemon(const DaemonConfig& config) {
  cv::setNumThreads(1);  // each of our threads does its own work; no pool behind our back

  // 1. Real-time memory and scheduling, or a refusal.
  safety::ReasonSet advisories = probe_real_time(config.loop);
  advisories.insert(look_at_security(config.security));
  advisories.insert(look_at_optics(config.optics));
  const safety::RegistrationInput registration = registration_input(config);

  const ControlParameters parameters = control_parameters(config, advisories);
  DaemonRecorder recorder{config, parameters};

  // 2. The domain is ours, or a refusal. Nothing is published before the first cycle.
  Publisher publisher{config, registration, advisories};

  // 3. Camera frames to the intake, from the intake to the tracker.
  FrameIntake intake{config.frame_check};
  TrackingThread tracking{config, intake};
  warn(tracking.warnings());

  // 4. The control loop, and on the same grid a little later the publishing thread.
  ControlInbox inbox;
  ControlCycle cycle{parameters, registration,   intake.arrivals(), tracking.for_control(),
                     inbox,      recorder.tape()};
  std::optional<OpticsThread> optics;
  if (!config.optics.are_fixed) {
    optics.emplace(open_bus(config.optics), config.optics.microscope,
                   thread_parameters(config.loop, "optics", config.loop.optics_priority,
                                     config.loop.period / 2),
                   inbox.optics);
    warn(optics->warnings());
  }
  const bridge::CameraSource camera{
      config.camera, [&intake](const bridge::CameraReport& report) { intake.on_report(report); }};
  spdlog::info("camera: {}", camera.description());
  std::atomic<std::uint64_t> cycles_controlled{0}, cycles_published{0};
  CyclicThread control{thread_parameters(config.loop, "control", config.loop.control_priority, 0ns),
                       [&](const CycleInfo& info) {
                         cycle.run(info);
                         cycles_controlled.fetch_add(1, std::memory_order_relaxed);
                       }};
  CyclicThread publishing{
      thread_parameters(config.loop, "publish", config.loop.publish_priority,
                        config.loop.publish_phase),
      [&](const CycleInfo&) {
        const bridge::CameraCounters counters = camera.counters();
        publisher.run(cycle.reports(), cycle.withdrawals(), tracking.for_publishing(), inbox,
                      {counters.frames, counters.incomplete, counters.missing,
                       intake.frames_skipped(), intake.clock_sigma(), recorder.advisories()});
        cycles_published.fetch_add(1, std::memory_order_relaxed);
      }};
  spdlog::info("running: domain {}, {} us loop, registration {:016x}", config.domain,
               config.loop.period / 1us, registration.id);

  // 5. Until told to end: log what changed, and tell the service manager while both threads run.
  bridge::service_is_ready();
  bridge::Progress<2> progress;
  int live_view_error = 0;
  while (!bridge::is_interrupted()) {
    if (progress.all_moved({cycles_controlled, cycles_published})) bridge::service_is_alive();
    log_changes(publisher.log());
    recorder.log_changes();
    if (const int error = tracking.live_view_error(); error != live_view_error) {
      live_view_error = error;
      if (error != 0) spdlog::warn("live view: {}", std::generic_category().message(error));
    }
    std::this_thread::sleep_for(kHousekeepingPeriod);
  }
  bridge::service_is_ending();
  control.stop();
  publishing.stop();
  publisher.publish_end();
  log_changes(publisher.log());
  spdlog::info("ended");
}

}  // namespace holdfast::rt
