// SPDX-License-Identifier: Apache-2.0
// What the rig renders, as small pictures for the documents.
#pragma once

#include <filesystem>

#include "tests/sim/or/room_files.hpp"

namespace holdfast::sim {

/// Nine JPEGs, 820 px wide and at most 120 kB each: the ear in each illumination, the three
/// cavities, a slice of the ear's CT through a bead, calibration views. The truth is empty.
[[nodiscard]] RoomFiles write_pictures(const std::filesystem::path& out, const Progress& progress);

}  // namespace holdfast::sim
