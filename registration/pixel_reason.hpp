// SPDX-License-Identifier: Apache-2.0
// Why a pixel of a reconstruction has a depth, or none.
#pragma once

#include <cstdint>

namespace holdfast::registration {

/// The numbers are those of the image that `reconstruct --reasons` writes, and stay.
enum class PixelReason : std::uint8_t {
  outside = 0,  ///< not in the region, or its match would lie beyond an image
  known = 1,
  unmatched = 2,  ///< no texture, no consistent or clear match, or beside a depth edge
  uncertain = 3,  ///< matched, and refused by what the fit says of its error
  repeating = 4   ///< fits nearly as well elsewhere along its row
};

}  // namespace holdfast::registration
