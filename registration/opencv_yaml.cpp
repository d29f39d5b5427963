// SPDX-License-Identifier: Apache-2.0
#include "registration/opencv_yaml.hpp"

#include <cctype>
#include <fstream>
#include <string_view>

#include <fmt/format.h>

#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

bool is_empty(std::string_view line) {
  const std::size_t first = line.find_first_not_of(" \t\r");
  return first == std::string_view::npos || line[first] == '#';
}

bool is_key(std::string_view line) {
  return std::isalpha(static_cast<unsigned char>(line.front())) != 0 || line.front() == '_';
}

}  // namespace

void require_one_document(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  enum class Expected { directive, start, key, rest } expected = Expected::directive;
  std::string line;
  for (int number = 1; std::getline(file, line); ++number) {
    const auto refuse = [&](const char* what) {
      throw InputError(
          fmt::format("{}: is not an OpenCV FileStorage file: line {} {}", path, number, what));
    };
    if (expected == Expected::directive) {
      if (!line.starts_with("%YAML:1.") && !line.starts_with("%YAML 1."))
        refuse("is not %YAML:1.0");
      expected = Expected::start;
    } else if (is_empty(line)) {
      continue;
    } else if (expected == Expected::start) {
      if (!line.starts_with("---") || !is_empty(std::string_view(line).substr(3)))
        refuse("is not ---");
      expected = Expected::key;
    } else if (expected == Expected::key) {
      if (!is_key(line)) refuse("does not begin with a key");
      expected = Expected::rest;
    } else if (line.starts_with("...")) {
      refuse("ends the document");
    }
  }
  if (expected != Expected::rest)
    throw InputError(path + ": is not an OpenCV FileStorage file: it holds nothing");
}

}  // namespace holdfast::registration
