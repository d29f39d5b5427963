// SPDX-License-Identifier: Apache-2.0
#include "rt/study/pattern_choice.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <string>

#include <fmt/format.h>
#include <toml++/toml.h>

#include "registration/pattern_table.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

using registration::PatternKind;

template <typename Value>
Value value_of(const std::string& file, const toml::table& table, const char* key) {
  const std::optional<Value> value = table[key].value<Value>();
  if (!value)
    throw InputError(fmt::format("{}:{}: pattern: {} is missing or of a wrong type", file,
                                 table.source().begin.line, key));
  return *value;
}

ZoomPattern pattern_of(const std::string& file, const toml::table& table) {
  ZoomPattern found;
  found.zoom = value_of<double>(file, table, "zoom");
  found.pattern.dot_px = value_of<double>(file, table, "dot_px");
  found.pattern.distance_px = value_of<double>(file, table, "distance_px");
  const auto seed = value_of<std::int64_t>(file, table, "seed");
  found.pattern.seed = static_cast<std::uint64_t>(seed);
  const auto kind = value_of<std::string>(file, table, "kind");
  bool is_known = false;
  for (const PatternKind each : {PatternKind::aperiodic, PatternKind::lattice, PatternKind::random})
    if (kind == registration::name(each)) {
      found.pattern.kind = each;
      is_known = true;
    }
  std::optional<std::string> wrong = registration::invalid_pattern(found.pattern);
  if (!is_known) wrong = "kind is '" + kind + "', must be aperiodic, lattice or random";
  if (!(found.zoom > 0 && std::isfinite(found.zoom))) wrong = "zoom must be positive";
  if (seed < 0) wrong = "seed must not be negative";
  if (wrong)
    throw InputError(fmt::format("{}:{}: pattern: {}", file, table.source().begin.line, *wrong));
  return found;
}

}  // namespace

std::vector<ZoomPattern> read_best_patterns(const std::filesystem::path& file) {
  std::vector<ZoomPattern> best;
  try {
    const toml::table root = toml::parse_file(file.string());
    if (const toml::array* patterns = root["pattern"].as_array())
      for (const toml::node& node : *patterns)
        if (const toml::table* table = node.as_table())
          best.push_back(pattern_of(file.string(), *table));
  } catch (const toml::parse_error& error) {
    throw InputError(
        fmt::format("{}:{}: {}", file.string(), error.source().begin.line, error.description()));
  }
  if (best.empty()) throw InputError(file.string() + ": holds no [[pattern]]");
  return best;
}

registration::PatternParameters pattern_for(double zoom, const std::vector<ZoomPattern>& best) {
  return std::min_element(best.begin(), best.end(),
                          [zoom](const ZoomPattern& a, const ZoomPattern& b) {
                            return std::abs(a.zoom - zoom) < std::abs(b.zoom - zoom);
                          })
      ->pattern;
}

}  // namespace holdfast::rt
