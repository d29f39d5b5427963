// SPDX-License-Identifier: Apache-2.0
// A LivePicture as bytes: header, points, mask, pixels, little-endian, each at a place that follows
// from the header alone. Pure; any thread.
//
//   0 "HFLIVE\r\n"  8 version  12 size of the header  16 sequence (odd: being written)  24 frame
//   ... then kLivePointsMax points, width/4 x height/4 of mask, width x height x channels of pixels
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "bridge/live_view/live_picture.hpp"

namespace holdfast::bridge {

inline constexpr std::string_view kLiveMagic = "HFLIVE\r\n";
inline constexpr std::uint32_t kLiveVersion = 1;
inline constexpr std::size_t kLiveSequenceAt = 16;  ///< uint64
inline constexpr std::size_t kLiveHeaderBytes = 168;
/// No file of a live view is longer.
inline constexpr std::size_t kLiveBytesMax =
    kLiveHeaderBytes + kLivePointsMax * sizeof(LivePoint) +
    static_cast<std::size_t>(kLiveSideMaxPx) * kLiveSideMaxPx * 3 +
    static_cast<std::size_t>(kLiveSideMaxPx / kLiveMaskCellPx) * (kLiveSideMaxPx / kLiveMaskCellPx);

/// Into `bytes`, reusing its memory. False, and `bytes` is void, when the picture is none that
/// unpack_live() would take.
[[nodiscard]] bool pack_live(const LivePicture& picture, std::uint64_t sequence,
                             std::vector<std::uint8_t>& bytes);

enum class LiveBytes : std::uint8_t {
  picture,
  unfinished,     ///< nothing written yet, or being written
  not_ours,       ///< another file
  other_version,  ///< another program's version of it
  damaged         ///< ends early, or says what cannot be
};

/// Takes any bytes. Into `picture`, reusing its memory, when LiveBytes::picture; else it is void.
[[nodiscard]] LiveBytes unpack_live(std::span<const std::uint8_t> bytes, LivePicture& picture);

}  // namespace holdfast::bridge
