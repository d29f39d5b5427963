// SPDX-License-Identifier: Apache-2.0
#include "rt/study/room.hpp"

#include <fmt/format.h>

namespace holdfast::rt {
namespace {

// The pattern's light is 740 nm and the OR lamps hardly shine there (paper A: under 10 uW), so
// little of theirs is left in a frame taken through the filter; laser dots speckle, an LED's do
// not.
std::string lights_text(const Room& room) {
  switch (room.illumination) {
    case Illumination::adaptive:
      return fmt::format(
          "or_light = 0.05\nmicroscope_light = 0.0\npattern = "
          "\"file\"\n"
          "pattern_file = \"{}\"\n",
          room.pattern.string());
    case Illumination::random:
      return "or_light = 0.05\nmicroscope_light = 0.0\npattern = "
             "\"diffractive\"\nspeckle = 0.3\n";
    case Illumination::or_light:
      return "or_light = 0.8\nmicroscope_light = 0.0\n";
    case Illumination::microscope:
      return "or_light = 0.0\nmicroscope_light = 0.9\n";
  }
  return {};
}

}  // namespace

std::string_view name(Illumination illumination) noexcept {
  switch (illumination) {
    case Illumination::adaptive:
      return "adaptive";
    case Illumination::random:
      return "random";
    case Illumination::or_light:
      return "or_light";
    case Illumination::microscope:
      return "microscope";
  }
  return "unknown";
}

bool has_pattern(Illumination illumination) noexcept {
  return illumination == Illumination::adaptive || illumination == Illumination::random;
}

std::string room_text(const Room& room) {
  return fmt::format(
      "seed = {}\n[phantom]\nkind = \"{}\"\nseed = {}\n[microscope]\nzoom = {}\n[lights]\n{}"
      "[poses]\ncount = {}\n[calibration]\nzoom_first = {}\nzoom_count = 1\npairs = {}\n",
      room.seed, room.phantom, room.phantom_seed, room.zoom, lights_text(room), room.poses,
      room.zoom, room.calibration_pairs);
}

}  // namespace holdfast::rt
