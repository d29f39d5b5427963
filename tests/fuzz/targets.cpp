// SPDX-License-Identifier: Apache-2.0
#include "tests/fuzz/targets.hpp"

#include <stdexcept>
#include <string_view>

#include "rt/core/error.hpp"

namespace holdfast::fuzz {

void require(bool holds, const char* what) {
  if (!holds) throw std::logic_error(what);
}

std::vector<const Target*> all_targets() {
  std::vector<const Target*> all;
  for (const auto& targets : {message_targets(), text_targets(), binary_targets()})
    for (const Target& target : targets) all.push_back(&target);
  return all;
}

bool is_accepted(const Target& target, std::span<const std::uint8_t> bytes) {
  try {
    target.take(bytes);
    return true;
  } catch (const Error& refusal) {
    const bool is_one_line = std::string_view(refusal.what()).find('\n') == std::string_view::npos;
    require(is_one_line, "a refusal of several lines");
    return false;
  }
}

}  // namespace holdfast::fuzz
