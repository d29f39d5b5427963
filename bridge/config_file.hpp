// SPDX-License-Identifier: Apache-2.0
// Reads an annotated TOML file strictly: a value of the wrong type, out of its range, or a key that
// nobody asked for is an error that names file, line, column, key, value, limit and unit. Units are
// the key's suffix (_ms, _mm, _hz ...); a duration is converted by it.
#pragma once

#include <chrono>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

namespace holdfast::bridge {

/// An inclusive range.
struct Range {
  double min;
  double max;
};

class ConfigFile;

/// One table of the file. A table that is missing in the file reads as empty: defaults apply.
/// Every read function throws InputError. Valid as long as its ConfigFile.
class ConfigSection {
 public:
  [[nodiscard]] ConfigSection section(std::string_view key) const;
  [[nodiscard]] bool has(std::string_view key) const;
  [[nodiscard]] double number(std::string_view key, double fallback, Range range) const;
  [[nodiscard]] int integer(std::string_view key, int fallback, Range range) const;
  [[nodiscard]] bool boolean(std::string_view key, bool fallback) const;
  [[nodiscard]] std::string text(std::string_view key, const std::string& fallback) const;
  /// One of `choices`.
  [[nodiscard]] std::string choice(std::string_view key, const std::string& fallback,
                                   const std::vector<std::string>& choices) const;
  /// A path; a relative one is relative to the file. Must be given unless `fallback` is not empty.
  [[nodiscard]] std::filesystem::path path(std::string_view key,
                                           const std::filesystem::path& fallback = {}) const;
  /// The key must end in _ns, _us, _ms or _s; `range` is in that unit.
  [[nodiscard]] std::chrono::nanoseconds duration(std::string_view key,
                                                  std::chrono::nanoseconds fallback,
                                                  Range range) const;
  /// Exactly `count` numbers; `fallback` when absent.
  [[nodiscard]] std::vector<double> numbers(std::string_view key, std::vector<double> fallback,
                                            std::size_t count, Range range) const;
  /// "file:line:column: section.key", for messages about the value of `key` by those who check
  /// more.
  [[nodiscard]] std::string where(std::string_view key) const;

 private:
  friend class ConfigFile;
  struct Node;
  explicit ConfigSection(std::shared_ptr<Node> node) : node_(std::move(node)) {}
  std::shared_ptr<Node> node_;
};

class ConfigFile {
 public:
  /// Throws InputError when the file cannot be read or is not TOML, UnavailableError never.
  explicit ConfigFile(const std::filesystem::path& file);
  [[nodiscard]] ConfigSection root() const;
  /// Throws InputError on the first key or table of the file that no one has asked for; suggests
  /// the asked-for key that is spelled most alike.
  void refuse_unknown_keys() const;

 private:
  std::shared_ptr<ConfigSection::Node> root_;
};

}  // namespace holdfast::bridge
