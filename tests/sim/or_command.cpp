// SPDX-License-Identifier: Apache-2.0
// `holdfast-sim or`: the virtual operating room's microscope, as files.
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include "bridge/atomic_file.hpp"
#include "bridge/command_line.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/commands.hpp"
#include "tests/sim/or/room.hpp"
#include "tests/sim/or/room_files.hpp"
#include "tests/sim/or/room_pictures.hpp"

namespace holdfast::sim {
namespace {

constexpr const char* kExample =
    "Example: calibration images for every zoom, then a stereo pair of the ear\n"
    "  holdfast-sim or --config config/or.toml --what calibration --out images/\n"
    "  holdfast-sim or --config config/or.toml --what stereo --out pair/ --truth truth.json";

struct Options {
  std::filesystem::path config, out, truth, pictures;
  std::string what = "stereo";
  bool is_json = false, is_check = false;
};

void report(int done, int all) {
  if (bridge::is_interrupted()) throw InterruptedError("interrupted");
  if (isatty(STDERR_FILENO) == 0) return;
  fmt::print(stderr, "\r{} of {}{}", done, all, done == all ? "\n" : "");
}

RoomFiles write(const Options& options) {
  if (!options.pictures.empty()) return write_pictures(options.pictures, report);
  if (options.config.empty()) throw InputError("--config is missing");
  const RoomConfig config = read_room_config(options.config);
  if (options.out.empty()) throw InputError("--out is missing");
  if (options.what == "calibration") return write_calibration_images(config, options.out, report);
  if (options.what == "sequence") return write_sequence(config, options.out, report);
  return write_stereo_images(config, options.out, report);
}

void run(const Options& options) {
  if (options.is_check && !options.config.empty()) {
    (void)read_room_config(options.config);
    return;
  }
  bridge::catch_interrupts();
  const auto start = std::chrono::steady_clock::now();
  const RoomFiles files = write(options);
  if (!options.truth.empty())
    bridge::write_file_atomically(options.truth.string(), files.truth + "\n");
  const double seconds =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  const std::string out = (options.pictures.empty() ? options.out : options.pictures).string();
  if (options.is_json)
    fmt::print("{}\n",
               nlohmann::json{{"what", options.pictures.empty() ? options.what : "pictures"},
                              {"out", out},
                              {"files", files.files},
                              {"seconds", seconds}}
                   .dump());
  else
    fmt::print("{}: {} files in {:.1f} s\n", out, files.files, seconds);
}

}  // namespace

void add_or_command(CLI::App& app) {
  const auto options = std::make_shared<Options>();
  CLI::App* command =
      app.add_subcommand("or", "The stereo microscope above a phantom: images as files.");
  command->add_option("--config", options->config, "the room (see config/or.toml)");
  command->add_option("--what", options->what, "which images")
      ->check(CLI::IsMember({"calibration", "stereo", "sequence"}))
      ->capture_default_str();
  command->add_option("--out", options->out, "folder for the images");
  command->add_option(
      "--pictures", options->pictures,
      "instead of all that: small pictures of what the rig renders, to this folder");
  command->add_option("--truth", options->truth,
                      "write what the pipeline must not know to this file (JSON)");
  command->add_flag("--check", options->is_check, "check the configuration and end");
  command->add_flag("--json", options->is_json, "one JSON object on stdout");
  command->footer(kExample);
  command->callback([options] { run(*options); });
}

}  // namespace holdfast::sim
