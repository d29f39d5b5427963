// SPDX-License-Identifier: Apache-2.0
// The images and files of a drawn hand-eye calibration, as `holdfast hand-eye` takes them.
#pragma once

#include <cstdint>
#include <filesystem>

#include "tests/registration/hand_eye/drawn_spots.hpp"

namespace holdfast::registration::test {

/// Writes stereo.yaml, spots.json and, for each spot, NAME_left.png and NAME_right.png into
/// `folder`, with left_off.png and right_off.png of the same site without a spot: a textured, lit
/// site with noise, 8 bit. The robot's points are the drawn ones, known to 0.05 mm. Throws
/// InputError naming the file that cannot be written.
void write_spot_images(const DrawnHandEye& drawn, const std::filesystem::path& folder,
                       std::uint64_t seed);

}  // namespace holdfast::registration::test
