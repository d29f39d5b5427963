// SPDX-License-Identifier: Apache-2.0
#include "rt/optics_thread.hpp"

#include <utility>

#include "bridge/can/local_can.hpp"
#include "bridge/can/socket_can.hpp"
#include "rt/core/clock.hpp"

namespace holdfast::rt {
namespace {

using bridge::can::Fault;
using safety::Reason;

Reason reason_of(Fault fault) noexcept {
  switch (fault) {
    case Fault::node_missing:
      return Reason::microscope_missing;
    case Fault::node_not_operational:
      return Reason::microscope_not_operational;
    case Fault::bus_off:
      return Reason::can_bus_off;
    case Fault::error_passive:
      return Reason::can_error_passive;
    case Fault::receive_overflow:
      return Reason::can_overflow;
    case Fault::interface_down:
      return Reason::can_down;
    case Fault::message_corrupt:
    case Fault::counter_skipped:
      return Reason::microscope_corrupt;
    case Fault::state_silent:
    case Fault::transmit_queue_full:  // the last three: of commands, and the daemon sends none
    case Fault::command_refused:
    case Fault::command_unconfirmed:
      break;
  }
  return Reason::microscope_silent;
}

}  // namespace

std::unique_ptr<bridge::can::Transport> open_bus(const OpticsParameters& parameters) {
  if (parameters.local.empty())
    return std::make_unique<bridge::can::SocketCan>(parameters.interface);
  return bridge::can::LocalCan::connect(parameters.local.string());
}

safety::ReasonSet optics_advisories(const OpticsParameters& parameters) noexcept {
  safety::ReasonSet advisories;
  if (parameters.are_fixed) advisories.insert(Reason::optics_unwatched);
  if (!parameters.local.empty()) advisories.insert(Reason::virtual_microscope);
  return advisories;
}

safety::OpticsInput optics_input(const bridge::can::MicroscopeReport& report,
                                 safety::Timestamp now) noexcept {
  safety::OpticsInput input;
  input.has_report = true;
  input.t_report = now;
  for (unsigned code = 0; code < bridge::can::kFaultCount; ++code) {
    const auto fault = static_cast<Fault>(code);
    if (report.faults.contains(fault)) input.faults.insert(reason_of(fault));
  }
  input.is_moving = report.is_moving;
  input.is_known = report.optics.has_value();
  if (report.optics) {
    input.zoom = report.optics->zoom;
    input.focus_mm = report.optics->focus_mm;
  }
  return input;
}

OpticsThread::OpticsThread(std::unique_ptr<bridge::can::Transport> bus,
                           const bridge::can::MicroscopeParameters& parameters,
                           const CyclicThreadParameters& thread, OpticsInbox& inbox)
    : inbox_(inbox),
      microscope_(std::move(bus), parameters, monotonic_now()),
      thread_(thread, [this](const CycleInfo&) { look(); }) {}

void OpticsThread::look() noexcept {
  const safety::Timestamp now = monotonic_now();
  const bridge::can::MicroscopeReport& report = microscope_.poll(now);
  const bool is_wanted = inbox_.recovery.exchange(false, std::memory_order_relaxed);
  if (is_wanted && bridge::can::needs_recovery(report.faults)) (void)microscope_.recover(now);
  inbox_.newest.publish(optics_input(report, now));
}

}  // namespace holdfast::rt
