// SPDX-License-Identifier: Apache-2.0
// `holdfast-sim serve`: the virtual operating room as a rig on two pipes.
#include "tests/sim/serve_command.hpp"

#include <iostream>
#include <string>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "bridge/command_line.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/or/room_server.hpp"

namespace holdfast::sim {
namespace {

using nlohmann::json;

constexpr const char* kExample =
    "Example: one stereo pair\n"
    "  echo '{\"do\": \"stereo\", \"config\": \"config/or.toml\", \"out\": \"pair\", \"pose\": 0}' "
    "| "
    "holdfast-sim serve\n"
    "Each line on stdin is a request: \"do\" is calibration, ct, stereo or depth-error. Each is\n"
    "answered by one line on stdout, {\"error\": ...} when it failed. Ends with its input.";

void check_interrupt() {
  if (bridge::is_interrupted()) throw InterruptedError("interrupted");
}

void run() {
  bridge::catch_interrupts();
  RoomServer server;
  for (std::string line; std::getline(std::cin, line);) {
    json answer;
    try {
      answer = server.answer(json::parse(line), [](int, int) { check_interrupt(); });
    } catch (const InterruptedError&) {
      throw;
    } catch (const std::exception& error) {
      answer = {{"error", error.what()}};
    }
    std::cout << answer.dump(-1, ' ', false, json::error_handler_t::replace) << std::endl;
    check_interrupt();
  }
}

}  // namespace

void add_serve_command(CLI::App& app) {
  CLI::App* command =
      app.add_subcommand("serve", "The microscope, the phantom and its CT, on request.");
  command->footer(kExample);
  command->callback([] { run(); });
}

}  // namespace holdfast::sim
