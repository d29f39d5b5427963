// SPDX-License-Identifier: Apache-2.0
// `holdfast project`: a pattern on the projector, until told to end.
#include <cstdio>
#include <memory>
#include <string>
#include <thread>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "bridge/command_line.hpp"
#include "bridge/image_file.hpp"
#include "bridge/sdl_projector.hpp"
#include "rt/commands/commands.hpp"
#include "rt/core/clock.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

constexpr std::chrono::milliseconds kService{20};

struct Options {
  std::string pattern;
  bridge::SdlProjectorParameters projector;
  double duration_s = 0;
  bool list = false, json = false;
};

void list(bool as_json) {
  nlohmann::json result = {{"displays", nlohmann::json::array()}};
  for (const bridge::Display& display : bridge::list_displays()) {
    const cv::Rect& area = display.area_px;
    result["displays"].push_back({{"index", display.index},
                                  {"name", display.name},
                                  {"width_px", area.width},
                                  {"height_px", area.height}});
    if (!as_json)
      fmt::print("{}  {}x{} px  {}\n", display.index, area.width, area.height, display.name);
  }
  if (as_json) fmt::print("{}\n", result.dump());
}

void show(const Options& options) {
  bridge::catch_interrupts();
  const cv::Mat pattern = bridge::read_image_file(options.pattern);
  bridge::SdlProjector projector(options.projector);
  projector.show(pattern);
  fmt::print(stderr, "{} on display {}, until interrupted\n", options.pattern,
             options.projector.display);
  const auto begin = monotonic_now();
  const auto is_over = [&] {
    return options.duration_s > 0 &&
           std::chrono::duration<double>(monotonic_now() - begin).count() >= options.duration_s;
  };
  while (!bridge::is_interrupted() && !is_over()) {
    projector.service();
    std::this_thread::sleep_for(kService);
  }
  projector.off();
  if (options.duration_s > 0 && !is_over())
    throw InterruptedError("interrupted before its duration was over");
  const double shown_s = std::chrono::duration<double>(monotonic_now() - begin).count();
  if (options.json)
    fmt::print("{}\n",
               nlohmann::json{{"display", options.projector.display}, {"shown_s", shown_s}}.dump());
}

}  // namespace

void add_project(CLI::App& app) {
  const auto options = std::make_shared<Options>();
  CLI::App& command = *app.add_subcommand(
      "project", "A pattern on the projector, pixel for pixel, until interrupted.");
  command.footer(
      "Example: dots on the second display\n"
      "  holdfast pattern --dots 4 --distance 3 --out dots.png\n"
      "  holdfast project --pattern dots.png --display 1");
  auto* pattern =
      command.add_option("--pattern", options->pattern, "8-bit grey image of the display's size");
  command.add_option("--display", options->projector.display, "see --list")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  command.add_option("--duration", options->duration_s, "s; otherwise until interrupted")
      ->check(CLI::PositiveNumber);
  command.add_flag("--json", options->json, "one JSON object on stdout");
  command.add_flag("--list", options->list, "list the displays and end")->excludes(pattern);
  command.callback([options] {
    if (options->list) {
      list(options->json);
      return;
    }
    if (options->pattern.empty()) throw CLI::RequiredError("--pattern");
    show(*options);
  });
}

}  // namespace holdfast::rt
