// SPDX-License-Identifier: Apache-2.0
#include "safety/crc32c.hpp"

#include <array>
#ifdef __SSE4_2__
#include <cstring>

#include <nmmintrin.h>
#endif

namespace holdfast::safety {
namespace {

constexpr std::uint32_t kPolynomial = 0x82F63B78U;
constexpr std::size_t kSlices = 8;
using Table = std::array<std::uint32_t, 256>;

/// kTables[k][b]: what byte b contributes once k further bytes have followed it (slicing-by-8).
constexpr std::array<Table, kSlices> make_tables() noexcept {
  std::array<Table, kSlices> tables{};
  for (std::uint32_t byte = 0; byte < 256; ++byte) {
    std::uint32_t crc = byte;
    for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1U) ^ ((crc & 1U) != 0U ? kPolynomial : 0U);
    tables[0][byte] = crc;
  }
  for (std::size_t slice = 1; slice < kSlices; ++slice) {
    for (std::size_t byte = 0; byte < 256; ++byte) {
      const std::uint32_t previous = tables[slice - 1][byte];
      tables[slice][byte] = (previous >> 8U) ^ tables[0][previous & 0xFFU];
    }
  }
  return tables;
}

constexpr std::array<Table, kSlices> kTables = make_tables();

}  // namespace

std::uint32_t crc32c_by_table(std::span<const std::byte> bytes, std::uint32_t crc) noexcept {
  std::uint32_t remainder = ~crc;
  while (bytes.size() >= kSlices) {
    std::uint32_t next = 0;
    for (std::size_t i = 0; i < kSlices; ++i) {
      const std::uint32_t old = i < 4 ? (remainder >> (8U * i)) & 0xFFU : 0U;
      next ^= kTables[kSlices - 1 - i][std::to_integer<std::uint32_t>(bytes[i]) ^ old];
    }
    remainder = next;
    bytes = bytes.subspan(kSlices);
  }
  for (const std::byte byte : bytes) {
    const std::uint32_t index = (remainder ^ std::to_integer<std::uint32_t>(byte)) & 0xFFU;
    remainder = (remainder >> 8U) ^ kTables[0][index];
  }
  return ~remainder;
}

#ifdef __SSE4_2__
std::uint32_t crc32c(std::span<const std::byte> bytes, std::uint32_t crc) noexcept {
  std::uint64_t remainder = ~crc;
  for (; bytes.size() >= sizeof(std::uint64_t); bytes = bytes.subspan(sizeof(std::uint64_t))) {
    std::uint64_t word = 0;
    std::memcpy(&word, bytes.data(), sizeof word);
    remainder = _mm_crc32_u64(remainder, word);
  }
  auto rest = static_cast<std::uint32_t>(remainder);
  for (const std::byte byte : bytes)
    rest = _mm_crc32_u8(rest, std::to_integer<unsigned char>(byte));
  return ~rest;
}
#else
std::uint32_t crc32c(std::span<const std::byte> bytes, std::uint32_t crc) noexcept {
  return crc32c_by_table(bytes, crc);
}
#endif

}  // namespace holdfast::safety
