// SPDX-License-Identifier: Apache-2.0
// What else is in view of a mastoidectomy: skin-like cover, retractors, blood. Only light meets it;
// the CT was taken without.
#pragma once

#include <cstdint>
#include <vector>

#include "tests/sim/or/cavity_phantom_drill.hpp"
#include "tests/sim/or/phantom.hpp"

namespace holdfast::sim {

/// Skin round the opening with a rolled edge, and two metal blades that hold it open. Frame site.
[[nodiscard]] std::vector<LitSurface> make_cover(std::uint32_t seed);

/// Blood that stands in the deepest part, level and mirror-smooth, and drops on the bone. Frame
/// site.
[[nodiscard]] std::vector<LitSurface> make_blood(const DrilledCavity& cavity, std::uint32_t seed);

}  // namespace holdfast::sim
