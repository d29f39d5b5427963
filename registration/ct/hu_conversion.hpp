// SPDX-License-Identifier: Apache-2.0
// Stored values to HU, in place: the inner loop of reading a CT.
#pragma once

#include <cstdint>
#include <span>

#include "registration/ct/dicom_pixels.hpp"

namespace holdfast::registration {

/// Each number holds a stored value as it stands in the file (16 bits, of which the layout uses
/// some) and becomes HU, rounded to 1 and clamped to int16. Returns whether one did not fit.
[[nodiscard]] bool convert_to_hu(const PixelLayout& layout, std::span<std::int16_t> values);

}  // namespace holdfast::registration
