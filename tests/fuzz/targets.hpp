// SPDX-License-Identifier: Apache-2.0
// The parsers of outside bytes, each behind one function that takes any bytes. A target ends when
// the parser has refused (a subtype of holdfast::Error, or its status) or accepted; what it accepts
// must hold what its header promises. Anything else, and any finding of a sanitizer, is a bug.
//
// libFuzzer drives them (fuzzer.cpp, fuzz.py); parsers_test.cpp repeats seeds and corpus in every
// build.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace holdfast::fuzz {

using Bytes = std::vector<std::uint8_t>;

struct Target {
  const char* name;
  std::vector<Bytes> (*seeds)();  ///< beside those of tests/fuzz/corpus/NAME
  /// Throws std::logic_error when something was accepted that must not be.
  void (*take)(std::span<const std::uint8_t> bytes);
};

[[nodiscard]] std::span<const Target> message_targets();  ///< CAN, DDS, HTTP
[[nodiscard]] std::span<const Target> text_targets();     ///< TOML, YAML, JSON, CSV
[[nodiscard]] std::span<const Target>
binary_targets();  ///< surfaces, depth, DICOM, live views, recordings
[[nodiscard]] std::vector<const Target*> all_targets();

/// True when the target accepted. Throws std::logic_error also on a refusal of several lines.
bool is_accepted(const Target& target, std::span<const std::uint8_t> bytes);

/// Throws std::logic_error unless `holds`.
void require(bool holds, const char* what);

[[nodiscard]] inline Bytes bytes_of_text(const std::string& text) {
  return {text.begin(), text.end()};
}

}  // namespace holdfast::fuzz
