// SPDX-License-Identifier: Apache-2.0
// The parsers of outside bytes, each behind one function that takes any bytes. A target ends when
// the parser has refused (a subtype of holdfast::Error, or its status) or accepted; what it accepts
// must hold what its header promises. Anything else, and any finding of a sanitizer, is a bug.
#pragma once

#include <span>
#include <vector>

#include "tests/fuzz/mutation.hpp"

namespace holdfast::fuzz {

struct Target {
  const char* name;
  std::vector<Bytes> (*seeds)();  ///< beside those of tests/fuzz/corpus/NAME
  /// Throws std::logic_error when something was accepted that must not be.
  void (*take)(std::span<const std::uint8_t> bytes);
};

[[nodiscard]] std::span<const Target> message_targets();
[[nodiscard]] std::span<const Target> file_targets();

/// Throws std::logic_error unless `holds`.
void require(bool holds, const char* what);

}  // namespace holdfast::fuzz
