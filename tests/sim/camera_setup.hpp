// SPDX-License-Identifier: Apache-2.0
// The files that a registration of the virtual site refers to.
#pragma once

#include <filesystem>

#include "tests/sim/scene.hpp"

namespace holdfast::sim {

/// Writes keyframe.png (the site at the identity pose; grey, or colour for a colour format),
/// depth.tiff (32-bit float, mm) and camera.yaml (OpenCV FileStorage) into `directory`, which is
/// made if needed. Throws InputError when that is not possible.
void write_setup(Scene& scene, bridge::PixelFormat format, const std::filesystem::path& directory);

}  // namespace holdfast::sim
