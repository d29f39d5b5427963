// SPDX-License-Identifier: Apache-2.0
// `holdfast-sim rig`: the virtual operating room as a rig on two pipes.
#include <filesystem>
#include <iostream>
#include <memory>
#include <optional>
#include <string>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "bridge/command_line.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/commands.hpp"
#include "tests/sim/or/room_server.hpp"

namespace holdfast::sim {
namespace {

using nlohmann::json;

constexpr const char* kExample =
    "Example: one pair under one pattern, and the same ear without it\n"
    "  echo '{\"do\": \"pair\", \"zoom\": 1.3, \"pattern\": \"dots.png\", \"off\": true, "
    "\"out\": \"pair\"}' | holdfast-sim rig\n"
    "Each line on stdin is a request: \"do\" is boards, ct, pair, depth-error, "
    "sequence,\ntracking-error, robot or beam-error (docs/interfaces.md, \"Rig\"). Each is "
    "answered by one line on stdout, "
    "{\"error\": ...} "
    "when it failed. Ends with its\ninput. Paths are relative to where it runs; the same requests "
    "give the same images.";

struct Options {
  std::filesystem::path config;
  std::optional<std::uint32_t> seed, phantom_seed;
  std::string phantom;
};

RoomConfig room_of(const Options& options) {
  RoomConfig config;
  if (options.config.empty()) {
    config.lights.or_light = 0.35;
    config.lights.microscope_light = 0;
  } else {
    config = read_room_config(options.config);
  }
  if (options.seed) {
    config.seed = config.optics.seed = *options.seed;
    config.board.seed = config.board_poses.seed = *options.seed;
  }
  if (!options.phantom.empty()) config.phantom = options.phantom;
  if (options.phantom_seed) config.phantom_seed = *options.phantom_seed;
  return config;
}

void check_interrupt() {
  if (bridge::is_interrupted()) throw InterruptedError("interrupted");
}

void run(const Options& options) {
  bridge::catch_interrupts();
  RoomServer server(room_of(options));
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

void add_rig_command(CLI::App& app) {
  const auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand(
      "rig", "The microscope, the phantom and its CT, on request: for holdfast's --rig.");
  command->add_option("--config", options->config,
                      "the room (see config/or.toml; default: an ear under OR light)");
  command->add_option("--seed", options->seed, "of the microscope, the board and the poses");
  command->add_option("--phantom", options->phantom, "the object (default: ear)")
      ->check(CLI::IsMember({"ear", "cavity_bone", "cavity_covered", "cavity_bloody", "relief"}));
  command->add_option("--phantom-seed", options->phantom_seed,
                      "of the phantom's shape; from 1000 on: kept for evaluation");
  command->footer(kExample);
  command->callback([options] { run(*options); });
}

}  // namespace holdfast::sim
