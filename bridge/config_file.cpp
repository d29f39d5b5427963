// SPDX-License-Identifier: Apache-2.0
#include "bridge/config_file.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <set>

#include <fmt/format.h>
#include <toml++/toml.h>

#include "rt/core/error.hpp"

namespace holdfast::bridge {

namespace {

/// What a file says may be quoted in a refusal, which is of one line.
std::string one_line(std::string_view text) {
  std::string line{text};
  std::replace_if(
      line.begin(), line.end(), [](char c) { return c == '\n' || c == '\r'; }, ' ');
  return line;
}

}  // namespace

struct ConfigSection::Node {
  std::shared_ptr<const toml::table> document;  // keeps `table` alive
  const toml::table* table = nullptr;           // null: the file does not have it
  std::filesystem::path file;
  std::string name;  // dotted, empty for the root
  std::set<std::string, std::less<>> asked;
  std::map<std::string, std::shared_ptr<Node>, std::less<>> children;

  const toml::node* find(std::string_view key) {
    asked.emplace(key);
    return table == nullptr ? nullptr : table->get(key);
  }
  [[nodiscard]] std::string dotted(std::string_view key) const {
    return name.empty() ? std::string{key} : fmt::format("{}.{}", name, key);
  }
  [[nodiscard]] std::string at(std::string_view key, const toml::node& node) const {
    const toml::source_position begin = node.source().begin;
    return fmt::format("{}:{}:{}: {}", file.string(), begin.line, begin.column,
                       one_line(dotted(key)));
  }
};

namespace {

constexpr std::uintmax_t kMaxFileBytes = 1 << 20;

std::string unit_of(std::string_view key) {
  constexpr std::array kUnits = {"_mm_per_s2", "_rad_per_s2", "_mm_per_s", "_rad_per_s", "_ns",
                                 "_us",        "_ms",         "_s",        "_mm",        "_um",
                                 "_rad",       "_hz",         "_px",       "_bytes",     "_db"};
  for (const std::string_view unit : kUnits) {
    if (!key.ends_with(unit)) continue;
    std::string text{unit.substr(1)};
    if (const auto per = text.find("_per_"); per != std::string::npos) text.replace(per, 5, "/");
    return " " + text;
  }
  return "";
}

double nanoseconds_per_unit(std::string_view key) {
  if (key.ends_with("_ns")) return 1;
  if (key.ends_with("_us")) return 1e3;
  if (key.ends_with("_ms")) return 1e6;
  if (key.ends_with("_s")) return 1e9;
  throw std::logic_error(fmt::format("duration key '{}' has no unit", key));
}

double checked(double value, Range range, const std::string& where, std::string_view key) {
  // Written so that a NaN is refused.
  if (value >= range.min && value <= range.max) return value;
  throw InputError(fmt::format("{} = {} is out of range {} to {}{}", where, value, range.min,
                               range.max, unit_of(key)));
}

double number_of(const toml::node& node, const std::string& where) {
  if (const auto value = node.value_exact<double>()) return *value;
  if (const auto value = node.value_exact<std::int64_t>()) return static_cast<double>(*value);
  throw InputError(fmt::format("{} is not a number", where));
}

std::size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> row(b.size() + 1);
  for (std::size_t j = 0; j <= b.size(); ++j) row[j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t substitution = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
      diagonal = row[j];
      row[j] = std::min({row[j] + 1, row[j - 1] + 1, substitution});
    }
  }
  return row[b.size()];
}

std::string suggestion(std::string_view key, const std::set<std::string, std::less<>>& known) {
  std::string best;
  std::size_t best_distance = key.size() / 2 + 1;
  for (const std::string& candidate : known) {
    const std::size_t distance = edit_distance(key, candidate);
    if (distance < best_distance) {
      best = candidate;
      best_distance = distance;
    }
  }
  return best.empty() ? "" : fmt::format("; did you mean '{}'?", best);
}

}  // namespace

ConfigSection ConfigSection::section(std::string_view key) const {
  const toml::node* found = node_->find(key);
  if (found != nullptr && !found->is_table())
    throw InputError(fmt::format("{} is not a table", node_->at(key, *found)));
  auto& child = node_->children[std::string{key}];
  if (child == nullptr) {
    child = std::make_shared<Node>();
    child->document = node_->document;
    child->table = found == nullptr ? nullptr : found->as_table();
    child->file = node_->file;
    child->name = node_->dotted(key);
  }
  return ConfigSection{child};
}

bool ConfigSection::has(std::string_view key) const {
  return node_->find(key) != nullptr;
}

double ConfigSection::number(std::string_view key, double fallback, Range range) const {
  const toml::node* found = node_->find(key);
  if (found == nullptr) return fallback;
  const std::string where = node_->at(key, *found);
  return checked(number_of(*found, where), range, where, key);
}

int ConfigSection::integer(std::string_view key, int fallback, Range range) const {
  const toml::node* found = node_->find(key);
  if (found == nullptr) return fallback;
  const std::string where = node_->at(key, *found);
  const auto value = found->value_exact<std::int64_t>();
  if (!value) throw InputError(fmt::format("{} is not a whole number", where));
  return static_cast<int>(checked(static_cast<double>(*value), range, where, key));
}

bool ConfigSection::boolean(std::string_view key, bool fallback) const {
  const toml::node* found = node_->find(key);
  if (found == nullptr) return fallback;
  const auto value = found->value_exact<bool>();
  if (!value) throw InputError(fmt::format("{} is neither true nor false", node_->at(key, *found)));
  return *value;
}

std::string ConfigSection::text(std::string_view key, const std::string& fallback) const {
  const toml::node* found = node_->find(key);
  if (found == nullptr) return fallback;
  const auto value = found->value_exact<std::string>();
  if (!value) throw InputError(fmt::format("{} is not a text", node_->at(key, *found)));
  return *value;
}

std::string ConfigSection::choice(std::string_view key, const std::string& fallback,
                                  const std::vector<std::string>& choices) const {
  std::string value = text(key, fallback);
  if (std::find(choices.begin(), choices.end(), value) == choices.end())
    throw InputError(
        fmt::format("{} = '{}' is none of {}", where(key), value, fmt::join(choices, ", ")));
  return value;
}

std::filesystem::path ConfigSection::path(std::string_view key,
                                          const std::filesystem::path& fallback) const {
  std::filesystem::path value = text(key, fallback.string());
  if (value.empty()) throw InputError(fmt::format("{} is missing", where(key)));
  return value.is_absolute() ? value : node_->file.parent_path() / value;
}

std::chrono::nanoseconds ConfigSection::duration(std::string_view key,
                                                 std::chrono::nanoseconds fallback,
                                                 Range range) const {
  const double unit_ns = nanoseconds_per_unit(key);
  const double value = number(key, static_cast<double>(fallback.count()) / unit_ns, range);
  return std::chrono::nanoseconds{std::llround(value * unit_ns)};
}

std::vector<double> ConfigSection::numbers(std::string_view key, std::vector<double> fallback,
                                           std::size_t count, Range range) const {
  const toml::node* found = node_->find(key);
  if (found == nullptr) return fallback;
  const std::string where = node_->at(key, *found);
  const toml::array* array = found->as_array();
  if (array == nullptr || array->size() != count)
    throw InputError(fmt::format("{} is not a list of {} numbers", where, count));
  std::vector<double> values;
  for (const toml::node& item : *array)
    values.push_back(checked(number_of(item, where), range, where, key));
  return values;
}

std::string ConfigSection::where(std::string_view key) const {
  const toml::node* found = node_->find(key);
  if (found != nullptr) return node_->at(key, *found);
  return fmt::format("{}: {}", node_->file.string(), node_->dotted(key));
}

ConfigFile::ConfigFile(const std::filesystem::path& file)
    : root_(std::make_shared<ConfigSection::Node>()) {
  std::error_code error;
  const std::uintmax_t size = std::filesystem::file_size(file, error);
  if (error) throw InputError(fmt::format("{}: {}", file.string(), error.message()));
  if (size > kMaxFileBytes)
    throw InputError(
        fmt::format("{}: {} bytes, at most {} are read", file.string(), size, kMaxFileBytes));
  try {
    root_->document = std::make_shared<const toml::table>(toml::parse_file(file.string()));
  } catch (const toml::parse_error& e) {
    throw InputError(fmt::format("{}:{}:{}: {}", file.string(), e.source().begin.line,
                                 e.source().begin.column, one_line(e.description())));
  }
  root_->table = root_->document.get();
  root_->file = file;
}

ConfigSection ConfigFile::root() const {
  return ConfigSection{root_};
}

void ConfigFile::refuse_unknown_keys() const {
  std::vector<const ConfigSection::Node*> pending{root_.get()};
  while (!pending.empty()) {
    const ConfigSection::Node* node = pending.back();
    pending.pop_back();
    if (node->table == nullptr) continue;
    for (const auto& [key, value] : *node->table) {
      if (!node->asked.contains(key.str()))
        throw InputError(fmt::format("{}: unknown key{}", node->at(key.str(), value),
                                     suggestion(key.str(), node->asked)));
    }
    for (const auto& [key, child] : node->children) pending.push_back(child.get());
  }
}

}  // namespace holdfast::bridge
