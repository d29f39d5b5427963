// SPDX-License-Identifier: Apache-2.0
// Expected values: RFC 3720, appendix B.4 (there in wire order, least significant byte first).
#include "safety/crc32c.hpp"

#include <array>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <string_view>

#include <gtest/gtest.h>

namespace holdfast::safety {
namespace {

using Block = std::array<std::uint8_t, 32>;

template <typename Range>
std::span<const std::byte> bytes_of(const Range& range) {
  return std::as_bytes(std::span(range.data(), range.size()));
}

TEST(Crc32c, MatchesRfc3720ForZeros) {
  const Block block{};
  EXPECT_EQ(crc32c(bytes_of(block)), 0x8A9136AAU);
}

TEST(Crc32c, MatchesRfc3720ForOnes) {
  Block block{};
  block.fill(0xFF);
  EXPECT_EQ(crc32c(bytes_of(block)), 0x62A8AB43U);
}

TEST(Crc32c, MatchesRfc3720ForIncrementingBytes) {
  Block block{};
  std::iota(block.begin(), block.end(), std::uint8_t{0});
  EXPECT_EQ(crc32c(bytes_of(block)), 0x46DD794EU);
}

TEST(Crc32c, MatchesRfc3720ForDecrementingBytes) {
  Block block{};
  std::iota(block.rbegin(), block.rend(), std::uint8_t{0});
  EXPECT_EQ(crc32c(bytes_of(block)), 0x113FDB5CU);
}

TEST(Crc32c, MatchesRfc3720ForIscsiReadCommand) {
  RecordProperty("requirement", "SR-40");
  const std::array<std::uint8_t, 48> command = {
      0x01, 0xc0, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
      0x00, 0x00, 0x00, 0x00, 0x14, 0x00, 0x00, 0x00, 0x00, 0x00, 0x04, 0x00,
      0x00, 0x00, 0x00, 0x14, 0x00, 0x00, 0x00, 0x18, 0x28, 0x00, 0x00, 0x00,
      0x00, 0x00, 0x00, 0x00, 0x02, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00};
  EXPECT_EQ(crc32c(bytes_of(command)), 0xD9963A56U);
}

TEST(Crc32c, MatchesCheckValueOfNineDigits) {
  const std::string_view digits = "123456789";  // not a multiple of the slice width
  EXPECT_EQ(crc32c(bytes_of(digits)), 0xE3069283U);
}

TEST(Crc32c, OfNothingIsZero) {
  EXPECT_EQ(crc32c({}), 0U);
}

TEST(Crc32c, OverPiecesEqualsOverTheWhole) {
  std::array<std::uint8_t, 61> data{};
  std::iota(data.begin(), data.end(), std::uint8_t{100});
  const auto whole = bytes_of(data);
  for (std::size_t cut = 0; cut <= whole.size(); ++cut) {
    EXPECT_EQ(crc32c(whole.subspan(cut), crc32c(whole.first(cut))), crc32c(whole)) << cut;
  }
}

TEST(Crc32c, ByTableIsTheSame) {
  std::array<std::uint8_t, 61> data{};
  std::iota(data.begin(), data.end(), std::uint8_t{200});
  const auto whole = bytes_of(data);
  for (std::size_t cut = 0; cut <= whole.size(); ++cut)
    EXPECT_EQ(crc32c_by_table(whole.subspan(cut), crc32c(whole.first(cut))), crc32c(whole)) << cut;
  const std::string_view digits = "123456789";
  EXPECT_EQ(crc32c_by_table(bytes_of(digits)), 0xE3069283U);
}

TEST(Crc32c, ChangesWithEverySingleBit) {
  RecordProperty("requirement", "SR-40");
  Block block{};
  std::iota(block.begin(), block.end(), std::uint8_t{7});
  const std::uint32_t good = crc32c(bytes_of(block));
  for (std::size_t bit = 0; bit < 8 * block.size(); ++bit) {
    Block flipped = block;
    flipped[bit / 8] = static_cast<std::uint8_t>(flipped[bit / 8] ^ (1U << (bit % 8)));
    EXPECT_NE(crc32c(bytes_of(flipped)), good) << bit;
  }
}

}  // namespace
}  // namespace holdfast::safety
