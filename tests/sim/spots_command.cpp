// SPDX-License-Identifier: Apache-2.0
// `holdfast-sim spots`: what `holdfast hand-eye` takes, of a robot whose place is known.
#include <cstdio>
#include <filesystem>
#include <memory>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "bridge/atomic_file.hpp"
#include "tests/registration/hand_eye/drawn_spot_images.hpp"
#include "tests/sim/commands.hpp"

namespace holdfast::sim {
namespace {

struct Options {
  std::filesystem::path out, truth;
  registration::test::DrawnSpots spots;
};

void run(Options options) {
  options.spots.pixel_sigma_px = 0;  // the images have noise of their own
  const registration::test::DrawnHandEye drawn = registration::test::draw_hand_eye(options.spots);
  std::filesystem::create_directories(options.out);
  registration::test::write_spot_images(drawn, options.out, options.spots.seed);
  if (!options.truth.empty()) {
    nlohmann::json rows = nlohmann::json::array();
    for (int row = 0; row < 4; ++row)
      for (int col = 0; col < 4; ++col) rows.push_back(drawn.T_robot_camera.matrix()(row, col));
    bridge::write_file_atomically(options.truth.string(),
                                  nlohmann::json{{"T_robot_camera", rows}}.dump(1) + "\n");
  }
  fmt::print("{}: {} spots at zoom {:g}, spots.json, stereo.yaml\n", options.out.string(),
             drawn.input.spots.size(), drawn.input.calibration.zoom);
}

}  // namespace

void add_spots_command(CLI::App& program) {
  const auto options = std::make_shared<Options>();
  CLI::App& command = *program.add_subcommand(
      "spots", "Images of a robot's aiming beam on a surface, with the robot's points.");
  command.footer(
      "Example: holdfast-sim spots --out spots/ --truth truth.json\n"
      "Drawn, not rendered: dots on a textured surface, with noise, through a camera that is a\n"
      "little off its calibration.");
  command.add_option("--out", options->out, "folder to be made")->required();
  command.add_option("--count", options->spots.count, "spots")
      ->check(CLI::Range(1, 100))
      ->capture_default_str();
  command.add_option("--relief-mm", options->spots.relief_mm, "half the range of heights; 0: flat")
      ->check(CLI::Range(0, 20))
      ->capture_default_str();
  command.add_option("--seed", options->spots.seed, "of places, calibration and noise")
      ->capture_default_str();
  command.add_option("--truth", options->truth, "JSON of the true T_robot_camera");
  command.callback([options] { run(*options); });
}

}  // namespace holdfast::sim
