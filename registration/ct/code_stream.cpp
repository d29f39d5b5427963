// SPDX-License-Identifier: Apache-2.0
#include "registration/ct/code_stream.hpp"

namespace holdfast::registration {
namespace {

std::uint32_t byte_at(std::string_view text, std::size_t at) {
  return static_cast<unsigned char>(text[at]);
}
std::uint32_t big16(std::string_view text, std::size_t at) {
  return byte_at(text, at) << 8U | byte_at(text, at + 1);
}
std::uint32_t big32(std::string_view text, std::size_t at) {
  return big16(text, at) << 16U | big16(text, at + 2);
}
std::uint32_t little32(std::string_view text, std::size_t at) {
  return byte_at(text, at) | byte_at(text, at + 1) << 8U | byte_at(text, at + 2) << 16U |
         byte_at(text, at + 3) << 24U;
}

/// PackBits into every second byte; exactly `pixels` of them.
bool unpack(std::string_view from, std::string& to, std::size_t offset, std::size_t pixels) {
  std::size_t at = 0, written = 0;
  while (written < pixels) {
    if (at >= from.size()) return false;
    const auto control = static_cast<signed char>(from[at++]);
    if (control == -128) continue;
    const bool is_run = control < 0;
    const auto count = static_cast<std::size_t>(is_run ? 1 - control : 1 + control);
    if (count > pixels - written || at + (is_run ? 1 : count) > from.size()) return false;
    for (std::size_t k = 0; k < count; ++k) to[2 * written++ + offset] = from[is_run ? at : at + k];
    at += is_run ? 1 : count;
  }
  return true;
}

}  // namespace

std::optional<CodeStreamSize> jpeg_size(std::string_view stream) {
  if (stream.size() < 4 || big16(stream, 0) != 0xFFD8) return std::nullopt;
  std::size_t at = 2;
  while (at + 10 <= stream.size()) {
    if (byte_at(stream, at) != 0xFF) return std::nullopt;
    const std::uint32_t marker = byte_at(stream, at + 1);
    if (marker == 0xFF) {  // a fill byte
      ++at;
      continue;
    }
    const bool is_frame =
        (marker >= 0xC0 && marker <= 0xCF && marker != 0xC4 && marker != 0xC8 && marker != 0xCC) ||
        marker == 0xF7;
    if (is_frame)
      return CodeStreamSize{big16(stream, at + 5), big16(stream, at + 7), byte_at(stream, at + 9),
                            byte_at(stream, at + 4)};
    if (marker == 0xDA || marker == 0xD9) return std::nullopt;
    at += 2 + big16(stream, at + 2);
  }
  return std::nullopt;
}

std::optional<CodeStreamSize> jpeg2000_size(std::string_view stream) {
  constexpr std::string_view kStart("\xFF\x4F\xFF\x51", 4);  // SOC, SIZ
  const std::size_t at = stream.substr(0, 4096).find(kStart);
  if (at == std::string_view::npos || at + 45 > stream.size()) return std::nullopt;
  const std::uint32_t right = big32(stream, at + 8), bottom = big32(stream, at + 12);
  const std::uint32_t left = big32(stream, at + 16), top = big32(stream, at + 20);
  const std::uint32_t components = big16(stream, at + 40);
  const bool is_full_size = byte_at(stream, at + 43) == 1 && byte_at(stream, at + 44) == 1;
  if (left > right || top > bottom || !is_full_size) return std::nullopt;
  return CodeStreamSize{bottom - top, right - left, components,
                        (byte_at(stream, at + 42) & 0x7FU) + 1};
}

std::optional<std::string> decode_rle16(std::string_view stream, std::size_t pixels) {
  if (stream.size() < 64 || little32(stream, 0) != 2) return std::nullopt;
  const std::uint32_t first = little32(stream, 4), second = little32(stream, 8);
  if (first < 64 || second < first || second > stream.size()) return std::nullopt;
  std::string bytes(2 * pixels, '\0');
  if (!unpack(stream.substr(first, second - first), bytes, 1, pixels) ||  // high bytes come first
      !unpack(stream.substr(second), bytes, 0, pixels))
    return std::nullopt;
  return bytes;
}

}  // namespace holdfast::registration
