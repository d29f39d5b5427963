// SPDX-License-Identifier: Apache-2.0
#include "tests/fuzz/mutation.hpp"

#include <algorithm>
#include <array>

namespace holdfast::fuzz {
namespace {

constexpr std::size_t kSizeMax = 1U << 16U;

/// What numbers, lists and texts are least expected to be.
constexpr std::array kWords = {"nan",
                               "-inf",
                               "1e999",
                               "-1",
                               "0",
                               "4294967296",
                               "18446744073709551616",
                               "9e-320",
                               "null",
                               "true",
                               "[]",
                               "{}",
                               "[[[[[[[[[[[[[[[[",
                               "\"",
                               "\\u0000",
                               "\n",
                               "# ",
                               "%YAML",
                               "\xff\xfe",
                               "element vertex 2000000000",
                               "format binary_big_endian 1.0",
                               "../../../etc/passwd"};
constexpr std::array<std::uint8_t, 6> kBytes = {0x00, 0xff, 0x7f, 0x80, 0x01, 0x20};

}  // namespace

Bytes Mutator::next(const std::vector<Bytes>& seeds) {
  Bytes bytes = seeds[below(seeds.size())];
  const std::size_t changes = std::size_t{1} + below(8);
  for (std::size_t i = 0; i < changes; ++i) change(bytes, seeds[below(seeds.size())]);
  if (bytes.size() > kSizeMax) bytes.resize(kSizeMax);
  return bytes;
}

void Mutator::put(Bytes& bytes, const std::string& text) {
  const std::size_t at = below(bytes.size() + 1);
  const std::size_t replaced = std::min(below(text.size() + 1), bytes.size() - at);
  const auto from = bytes.begin() + static_cast<std::ptrdiff_t>(at);
  bytes.insert(bytes.erase(from, from + static_cast<std::ptrdiff_t>(replaced)), text.begin(),
               text.end());
}

void Mutator::change(Bytes& bytes, const Bytes& other) {
  if (bytes.empty()) return put(bytes, kWords[below(kWords.size())]);
  const std::size_t at = below(bytes.size());
  const auto from = bytes.begin() + static_cast<std::ptrdiff_t>(at);
  const std::size_t length = std::min(below(64) + 1, bytes.size() - at);
  const auto to = from + static_cast<std::ptrdiff_t>(length);
  switch (below(7)) {
    case 0:
      bytes[at] = static_cast<std::uint8_t>(bytes[at] ^ (1U << below(8)));
      break;
    case 1:
      bytes[at] = kBytes[below(kBytes.size())];
      break;
    case 2:
      bytes.erase(from, to);
      break;
    case 3: {
      const Bytes piece(from, to);
      const auto place = bytes.begin() + static_cast<std::ptrdiff_t>(below(bytes.size()));
      bytes.insert(place, piece.begin(), piece.end());
      break;
    }
    case 4:
      bytes.resize(at);
      break;
    case 5: {
      const std::size_t first = below(other.size());
      bytes.insert(from, other.begin() + static_cast<std::ptrdiff_t>(first), other.end());
      break;
    }
    default:
      put(bytes, kWords[below(kWords.size())]);
  }
}

}  // namespace holdfast::fuzz
