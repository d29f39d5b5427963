// SPDX-License-Identifier: Apache-2.0
// CRC-32C (Castagnoli, reflected polynomial 0x82F63B78, init and final XOR 0xFFFFFFFF), as in
// iSCSI (RFC 3720, B.4). Pure, noexcept, allocation-free.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace holdfast::safety {

/// CRC-32C of `bytes`; pass the previous result as `crc` to go on over several pieces.
[[nodiscard]] std::uint32_t crc32c(std::span<const std::byte> bytes,
                                   std::uint32_t crc = 0) noexcept;

/// The same by tables, for processors without an instruction for it: crc32c() is one or the other.
[[nodiscard]] std::uint32_t crc32c_by_table(std::span<const std::byte> bytes,
                                            std::uint32_t crc = 0) noexcept;

}  // namespace holdfast::safety
