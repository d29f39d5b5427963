// SPDX-License-Identifier: Apache-2.0
// Inputs that are nearly right: a seed with a few of the changes that parsers trip over.
#pragma once

#include <cstdint>
#include <random>
#include <string>
#include <vector>

namespace holdfast::fuzz {

using Bytes = std::vector<std::uint8_t>;

class Mutator {
 public:
  explicit Mutator(std::uint64_t seed) : random_(seed) {}

  /// One of `seeds` with 1 to 8 changes; seeds must not be empty.
  [[nodiscard]] Bytes next(const std::vector<Bytes>& seeds);

 private:
  [[nodiscard]] std::size_t below(std::size_t count) { return count == 0 ? 0 : random_() % count; }
  void change(Bytes& bytes, const Bytes& other);
  void put(Bytes& bytes, const std::string& text);

  std::mt19937_64 random_;
};

}  // namespace holdfast::fuzz
