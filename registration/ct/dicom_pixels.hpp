// SPDX-License-Identifier: Apache-2.0
// The pixels of one CT slice as HU. Native pixels are read here; compressed ones (RLE, JPEG,
// JPEG-LS, JPEG 2000) are decoded by GDCM, after the code stream's own size has been checked.
#pragma once

#include <cstdint>
#include <span>
#include <string>

#include "registration/ct/dicom_header.hpp"

namespace holdfast::registration {

struct PixelLayout {
  int rows = 0, columns = 0;
  int bits_allocated = 16, bits_stored = 16, high_bit = 15;
  bool is_signed = false;
  double slope = 1, intercept = 0;  ///< HU = slope * stored + intercept
};

/// Checks everything that describes the pixels. Throws RefusedError naming file, attribute, value.
[[nodiscard]] PixelLayout pixel_layout(const DicomHeader& header);

/// Fills `hu`, which has rows * columns numbers, with HU, rounded to 1 and clamped to int16.
/// Returns whether a value did not fit. Throws RefusedError naming the file: truncated or broken
/// pixel data, more or fewer pixels than rows and columns say, a transfer syntax that is not
/// supported. Thread-safe.
[[nodiscard]] bool decode_hu(const DicomHeader& header, const PixelLayout& layout,
                             std::span<std::int16_t> hu);

/// What the transfer syntax does to the pixels.
[[nodiscard]] bool is_lossy(const std::string& transfer_syntax);

}  // namespace holdfast::registration
