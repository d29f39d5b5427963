// SPDX-License-Identifier: Apache-2.0
// What the rig is asked to set up: phantom, zoom, illumination. Written as the file that the
// virtual operating room reads (config/or.toml).
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>

namespace holdfast::rt {

/// Paper A, "Method comparisons".
enum class Illumination { adaptive, random, or_light, microscope };
inline constexpr std::array<Illumination, 4> kIlluminations{
    Illumination::adaptive, Illumination::random, Illumination::or_light, Illumination::microscope};
[[nodiscard]] std::string_view name(Illumination illumination) noexcept;
/// Whether a pattern is projected: markers then need frames of their own.
[[nodiscard]] bool has_pattern(Illumination illumination) noexcept;

struct Room {
  std::uint32_t seed = 1;  ///< of the microscope, the poses and the noise
  std::string phantom = "ear";
  std::uint32_t phantom_seed = 1000;  ///< from 1000 on: shapes kept for evaluation
  double zoom = 1.3;
  int poses = 1;
  int calibration_pairs = 19;
  Illumination illumination = Illumination::adaptive;
  std::filesystem::path pattern;  ///< the adaptive one, absolute
};

/// The OR lamps for the frames that show the markers, for the request "stereo": with the pattern
/// on, they are all but filtered out.
inline constexpr double kMarkerOrLight = 0.6;

/// The file's content. Light is the same whatever the zoom, as in the paper.
[[nodiscard]] std::string room_text(const Room& room);

}  // namespace holdfast::rt
