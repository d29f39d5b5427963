// SPDX-License-Identifier: Apache-2.0
// Paper A, "Method comparisons": what the ear is lit by.
#pragma once

#include <array>
#include <filesystem>
#include <string_view>

#include "rt/study/rig.hpp"

namespace holdfast::rt {

enum class Illumination { adaptive, random, or_light, microscope };
inline constexpr std::array<Illumination, 4> kIlluminations{
    Illumination::adaptive, Illumination::random, Illumination::or_light, Illumination::microscope};
[[nodiscard]] std::string_view name(Illumination illumination) noexcept;
/// Whether a pattern is projected: markers then need frames of their own.
[[nodiscard]] bool has_pattern(Illumination illumination) noexcept;

/// What the rig is asked for; `adaptive`: the pattern's file. Zoom, pose and folder are the
/// caller's.
[[nodiscard]] PairRequest lit_by(Illumination illumination, const std::filesystem::path& adaptive);

}  // namespace holdfast::rt
