// SPDX-License-Identifier: Apache-2.0
// What a compressed picture says of itself, so that a decoder is never given a buffer of another
// size, and an RLE decoder of our own (DICOM PS3.5, annex G).
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace holdfast::registration {

struct CodeStreamSize {
  std::uint32_t rows = 0, columns = 0, components = 0, bits = 0;
};

/// Of a JPEG or JPEG-LS stream (its frame header), or of a JPEG 2000 code stream or JP2 file
/// (SIZ); nothing where none is found.
[[nodiscard]] std::optional<CodeStreamSize> jpeg_size(std::string_view stream);
[[nodiscard]] std::optional<CodeStreamSize> jpeg2000_size(std::string_view stream);

/// One frame of 16-bit pixels, little-endian; nothing when broken or of another size.
[[nodiscard]] std::optional<std::string> decode_rle16(std::string_view stream, std::size_t pixels);

}  // namespace holdfast::registration
