// SPDX-License-Identifier: Apache-2.0
// The virtual camera's faults as lines of text: from a script or from a local socket. The protocol
// is described in docs/camera.md.
#pragma once

#include <chrono>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "tests/sim/moving_site.hpp"
#include "tests/sim/virtual_camera.hpp"

namespace holdfast::sim {

class CameraControl {
 public:
  /// Called once for each command that took effect.
  using OnEvent = std::function<void(std::chrono::nanoseconds t, const std::string& event,
                                     const std::string& detail)>;
  /// `site`: null when the pixels come from files; then `motion` is refused.
  CameraControl(VirtualCamera& camera, MovingSite* site, OnEvent on_event);

  /// Carries out one line; returns when it took effect (CLOCK_MONOTONIC). Throws InputError, or
  /// UnavailableError when the device cannot reconnect; then nothing has changed.
  std::chrono::nanoseconds run(std::string_view line);

 private:
  VirtualCamera& camera_;
  MovingSite* site_;
  OnEvent on_event_;
};

/// A script: "SECONDS:COMMAND;SECONDS:COMMAND...", seconds since the start, not decreasing. Throws
/// InputError.
struct ScriptedCommand {
  std::chrono::nanoseconds t;  ///< since the start
  std::string line;
};
[[nodiscard]] std::vector<ScriptedCommand> parse_fault_script(std::string_view script);

/// A Unix stream socket that answers each line with "ok <t_monotonic_ns>" or "error <reason>".
class ControlSocket {
 public:
  using Answer = std::function<std::chrono::nanoseconds(std::string_view line)>;
  /// Replaces a dead socket file at `path`; throws UnavailableError when a live one is there.
  ControlSocket(std::string path, Answer answer);
  ~ControlSocket();
  ControlSocket(const ControlSocket&) = delete;
  ControlSocket& operator=(const ControlSocket&) = delete;

  /// Waits up to `timeout` for a connection or a line and answers it on this thread.
  void serve(std::chrono::milliseconds timeout);

 private:
  struct Client {
    int descriptor;
    std::string received;
  };
  void accept_client();
  [[nodiscard]] bool read_from(Client& client);

  std::string path_;
  Answer answer_;
  int listener_ = -1;
  std::vector<Client> clients_;
};

}  // namespace holdfast::sim
