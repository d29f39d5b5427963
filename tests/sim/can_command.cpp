// SPDX-License-Identifier: Apache-2.0
// holdfast-sim can: the virtual microscope on a CAN interface, or on the local bus of a host
// without.
#include <charconv>
#include <csignal>
#include <memory>
#include <optional>
#include <string_view>

#include <fmt/format.h>
#include <poll.h>

#include "bridge/can/local_can.hpp"
#include "bridge/can/socket_can.hpp"
#include "rt/core/clock.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/camera_control.hpp"
#include "tests/sim/commands.hpp"
#include "tests/sim/microscope_node.hpp"

namespace holdfast::sim {
namespace {

struct Options {
  std::string interface, local, control;
  MicroscopeNodeParameters node;
  int node_id = 1;
};

volatile std::sig_atomic_t is_ending = 0;
void end(int /*signal*/) {
  is_ending = 1;
}

/// "zoom 1.3", "focus 210": somebody turns the knob. "silent on", "silent off": the node's plug.
std::chrono::nanoseconds obey(MicroscopeNode& node, std::string_view line) {
  const std::size_t space = line.find(' ');
  const std::string_view what = line.substr(0, space);
  const std::string_view value =
      space == std::string_view::npos ? std::string_view() : line.substr(space + 1);
  if (what == "silent" && (value == "on" || value == "off")) {
    node.is_silent = value == "on";
    return rt::monotonic_now();
  }
  double number = 0;
  const auto [end, error] = std::from_chars(value.data(), value.data() + value.size(), number);
  const bool is_number = error == std::errc{} && end == value.data() + value.size();
  if (!is_number || (what != "zoom" && what != "focus"))
    throw InputError(
        fmt::format("\"{}\": expected zoom NUMBER, focus MM, silent on or silent off", line));
  node.turn(what == "zoom" ? bridge::can::Quantity::zoom : bridge::can::Quantity::focus, number);
  return rt::monotonic_now();
}

/// Waits for a frame or a millisecond, whatever comes first; with a control socket, for a line too.
void wait(const MicroscopeNode& node, std::optional<ControlSocket>& control) {
  if (control) return control->serve(std::chrono::milliseconds(1));
  pollfd waiting{node.transport().handle(), POLLIN, 0};
  ::poll(&waiting, 1, 1);
}

void run(Options& options) {
  options.node.node = static_cast<std::uint8_t>(options.node_id);
  std::unique_ptr<bridge::can::Transport> transport;
  if (options.local.empty())
    transport = std::make_unique<bridge::can::SocketCan>(options.interface);
  else
    transport = bridge::can::LocalCan::listen(options.local);
  MicroscopeNode node(std::move(transport), options.node);
  std::signal(SIGINT, end);
  std::signal(SIGTERM, end);
  fmt::print(
      stderr, "can: virtual microscope, node {}, on {}\n", options.node_id,
      options.local.empty() ? options.interface : options.local + " (local bus: this is no CAN)");
  std::optional<ControlSocket> control;
  if (!options.control.empty())
    control.emplace(options.control, [&node](std::string_view line) { return obey(node, line); });
  while (is_ending == 0) {
    node.poll(rt::monotonic_now());
    wait(node, control);
  }
}

}  // namespace

void add_can_command(CLI::App& app) {
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand(
      "can",
      "The virtual microscope: zoom, focus and illumination on CAN (docs/can.md), until ended.\n"
      "Example: holdfast-sim can --interface vcan0 --zoom 1.0 --focus-mm 200");
  auto* interface = command->add_option("--interface", options->interface, "CAN interface");
  command->add_option("--local", options->local, "path of a local bus, for hosts without CAN")
      ->excludes(interface);
  command->add_option("--control", options->control,
                      "Unix socket that takes lines: zoom 1.3, focus 210, silent on|off");
  command->add_flag("--fd", options->node.is_fd, "send CAN FD frames");
  command->add_option("--node", options->node_id)->check(CLI::Range(1, 127))->capture_default_str();
  command->add_option("--zoom", options->node.optics.zoom)->check(CLI::Range(0.1, 6.5));
  command->add_option("--focus-mm", options->node.optics.focus_mm)->check(CLI::Range(1.0, 16777.0));
  command->add_option("--illumination", options->node.optics.illumination_percent)
      ->check(CLI::Range(0.0, 100.0));
  command->callback([options] {
    if (options->interface.empty() && options->local.empty())
      throw CLI::RequiredError("--interface or --local");
    run(*options);
  });
}

}  // namespace holdfast::sim
