// SPDX-License-Identifier: Apache-2.0
// `holdfast-sim rig`: the virtual microscope as `holdfast optimize-pattern` wants a rig.
#include <filesystem>
#include <memory>

#include <CLI/CLI.hpp>

#include "bridge/atomic_file.hpp"
#include "bridge/command_line.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/commands.hpp"
#include "tests/sim/or/room.hpp"
#include "tests/sim/or/room_files.hpp"

namespace holdfast::sim {
namespace {

constexpr const char* kExample =
    "Example: one pair under one pattern\n"
    "  holdfast-sim rig --config config/or.toml --zoom 1.3 --pattern dots.png --out pair/\n"
    "Phantom, pose and lights are the configuration's; the same arguments give the same images.";

struct Options {
  std::filesystem::path config, pattern, out, truth;
  double zoom = 0;
};

void run(const Options& options) {
  bridge::catch_interrupts();
  RoomConfig config = read_room_config(options.config);
  config.zoom = options.zoom;
  config.pattern = "file";
  config.pattern_file = std::filesystem::absolute(options.pattern);
  config.poses = 1;
  const RoomFiles files = write_stereo_images(config, options.out, [](int, int) {
    if (bridge::is_interrupted()) throw InterruptedError("interrupted");
  });
  if (!options.truth.empty())
    bridge::write_file_atomically(options.truth.string(), files.truth + "\n");
}

}  // namespace

void add_rig_command(CLI::App& app) {
  const auto options = std::make_shared<Options>();
  CLI::App* command =
      app.add_subcommand("rig", "A pair of images under a pattern, for holdfast optimize-pattern.");
  command->add_option("--config", options->config, "the room (see config/or.toml)")->required();
  command->add_option("--zoom", options->zoom, "1.1 to 1.5")->required();
  command->add_option("--pattern", options->pattern, "800x600 PNG")->required();
  command->add_option("--out", options->out, "folder for left.png and right.png")->required();
  command->add_option("--truth", options->truth,
                      "write what the pipeline must not know to this file (JSON)");
  command->footer(kExample);
  command->callback([options] { run(*options); });
}

}  // namespace holdfast::sim
