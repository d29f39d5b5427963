// SPDX-License-Identifier: Apache-2.0
// `holdfast pattern`: an image for the projector.
#include "registration/pattern.hpp"

#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>

#include "bridge/atomic_file.hpp"
#include "rt/commands/commands.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

constexpr const char* kExample =
    "Example: dots of 4 px, 3 px apart, that no matcher can take for their neighbours\n"
    "  holdfast pattern --dots 4 --distance 3 --out dots.png\n"
    "The image is 800x600 (the projector's mirrors). --lattice is paper A's regular pattern: a\n"
    "matcher may lock one period off on it, so it is not the default.";

struct Options {
  registration::PatternParameters parameters;
  bool is_lattice = false, is_random = false, is_json = false;
  std::string out;
};

void run(Options options) {
  using registration::PatternKind;
  if (options.is_lattice) options.parameters.kind = PatternKind::lattice;
  if (options.is_random) options.parameters.kind = PatternKind::random;
  if (const auto invalid = registration::invalid_pattern(options.parameters))
    throw InputError(*invalid);
  const cv::Mat image = registration::make_pattern(options.parameters);
  std::vector<std::uint8_t> png;
  cv::imencode(".png", image, png);
  bridge::write_file_atomically(
      options.out, std::string_view{reinterpret_cast<const char*>(png.data()), png.size()});
  const double lit = cv::mean(image)[0] / 255;
  if (options.is_json)
    fmt::print("{}\n", nlohmann::json{{"out", options.out},
                                      {"width_px", image.cols},
                                      {"height_px", image.rows},
                                      {"lit_share", lit}}
                           .dump());
  else
    fmt::print("{}: {}x{} px, {:.1f} % lit\n", options.out, image.cols, image.rows, 100 * lit);
}

}  // namespace

void add_pattern(CLI::App& app) {
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("pattern", "An image for the pattern projector.");
  command->add_option("--dots", options->parameters.dot_px, "Diameter of a dot, 2 to 16 px")
      ->capture_default_str();
  command->add_option("--distance", options->parameters.distance_px, "Gap between dots, 1 to 10 px")
      ->capture_default_str();
  CLI::Option* lattice =
      command->add_flag("--lattice", options->is_lattice,
                        "Paper A's regular pattern; it can slip by a period: for comparison only");
  command->add_flag("--random", options->is_random, "Dots anywhere")->excludes(lattice);
  command->add_option("--seed", options->parameters.seed, "Of chance")->capture_default_str();
  command->add_option("--out", options->out, "PNG file")->required();
  command->add_flag("--json", options->is_json, "Print one JSON object on stdout");
  command->footer(kExample);
  command->callback([options] { run(*options); });
}

}  // namespace holdfast::rt
