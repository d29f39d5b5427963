// SPDX-License-Identifier: Apache-2.0
// The microscope's encoders on a thread of their own: what the node says now, every millisecond, to
// the control loop. What it means is the gate's to say.
#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "bridge/can/microscope.hpp"
#include "rt/core/cyclic_thread.hpp"
#include "rt/optics_inbox.hpp"

namespace holdfast::rt {

/// Where zoom and focus are read; exactly one of the three is set.
struct OpticsParameters {
  std::string interface;  ///< of SocketCAN, "can0"; brought up with its bit rate by the system
  std::filesystem::path local;  ///< a local bus instead: a virtual microscope, not CAN
  bool are_fixed = false;       ///< declared: nobody can turn them; nothing is read
  bridge::can::MicroscopeParameters microscope;
};

/// The bus that `parameters` name. Throws UnavailableError, InputError; `are_fixed` must not be
/// set.
[[nodiscard]] std::unique_ptr<bridge::can::Transport> open_bus(const OpticsParameters& parameters);

/// What every health message must say of `parameters`: optics_unwatched for fixed optics,
/// virtual_microscope for a local bus, nothing for CAN.
[[nodiscard]] safety::ReasonSet optics_advisories(const OpticsParameters& parameters) noexcept;

/// What a look at the microscope tells the gate: every fault under its reason. Pure, noexcept.
[[nodiscard]] safety::OpticsInput optics_input(const bridge::can::MicroscopeReport& report,
                                               safety::Timestamp now) noexcept;

class OpticsThread {
 public:
  /// Starts looking, once a period of `thread`. After a fault that stays it recovers when, and only
  /// when, OpticsInbox::recovery is set. Throws as CyclicThread and Microscope do. `inbox` must
  /// outlive it.
  OpticsThread(std::unique_ptr<bridge::can::Transport> bus,
               const bridge::can::MicroscopeParameters& parameters,
               const CyclicThreadParameters& thread, OpticsInbox& inbox);

  [[nodiscard]] const std::vector<std::string>& warnings() const noexcept {
    return thread_.warnings();
  }

 private:
  void look() noexcept;

  OpticsInbox& inbox_;
  bridge::can::Microscope microscope_;
  CyclicThread thread_;  // last: it runs look()
};

}  // namespace holdfast::rt
