// SPDX-License-Identifier: Apache-2.0
#include "registration/pattern_table.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>

#include <fmt/format.h>

#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

constexpr std::string_view kColumns =
    "zoom,distance_px,dot_px,status,objective_mm,triangle_mean_mm,closest_mean_mm,wrong_share,"
    "coverage";

std::string head_line(const PatternTableHead& head) {
  return fmt::format("# holdfast optimize-pattern: {} dots, {} objective, seed {}", name(head.kind),
                     head.is_paper ? "paper" : "robust", head.seed);
}

std::vector<std::string_view> split(std::string_view text, char at) {
  std::vector<std::string_view> parts;
  for (;;) {
    const std::size_t end = text.find(at);
    parts.push_back(text.substr(0, end));
    if (end == std::string_view::npos) return parts;
    text.remove_prefix(end + 1);
  }
}

template <typename T>
bool read(std::string_view text, T& value) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc{} && end == text.data() + text.size();
}

bool parse_row(std::string_view line, PatternEvaluation& e) {
  const auto cells = split(line, ',');
  if (cells.size() != 9) return false;
  e.status = cells[3];
  const bool is_read = read(cells[0], e.zoom) && read(cells[1], e.dots.distance_px) &&
                       read(cells[2], e.dots.dot_px) && read(cells[4], e.objective_mm) &&
                       read(cells[5], e.triangle_mean_mm) && read(cells[6], e.closest_mean_mm) &&
                       read(cells[7], e.wrong_share) && read(cells[8], e.coverage);
  const auto dots = all_dots();
  return is_read && std::isfinite(e.zoom) && std::isfinite(e.objective_mm) && e.objective_mm > 0 &&
         std::find(dots.begin(), dots.end(), e.dots) != dots.end();
}

}  // namespace

std::string_view name(PatternKind kind) noexcept {
  switch (kind) {
    case PatternKind::aperiodic:
      return "aperiodic";
    case PatternKind::lattice:
      return "lattice";
    case PatternKind::random:
      break;
  }
  return "random";
}

std::string pattern_table_text(const PatternTableHead& head,
                               const std::vector<PatternEvaluation>& evaluations) {
  std::string text = head_line(head) + '\n' + std::string(kColumns) + '\n';
  for (const PatternEvaluation& e : evaluations)
    text += fmt::format("{},{},{},{},{},{},{},{},{}\n", e.zoom, e.dots.distance_px, e.dots.dot_px,
                        e.status, e.objective_mm, e.triangle_mean_mm, e.closest_mean_mm,
                        e.wrong_share, e.coverage);
  return text;
}

std::vector<PatternEvaluation> parse_pattern_table(const std::string& path, std::string_view text,
                                                   const PatternTableHead& head) {
  std::vector<PatternEvaluation> evaluations;
  auto lines = split(text, '\n');
  if (!lines.empty() && lines.back().empty()) lines.pop_back();
  if (lines.empty() || lines[0] != head_line(head))
    throw InputError(
        fmt::format("{}: is of another search; line 1 must be '{}'", path, head_line(head)));
  if (lines.size() < 2 || lines[1] != kColumns)
    throw InputError(fmt::format("{}: line 2 must be '{}'", path, kColumns));
  for (std::size_t i = 2; i < lines.size(); ++i)
    if (!parse_row(lines[i], evaluations.emplace_back()))
      throw InputError(fmt::format("{}: line {}: '{}' is no evaluation", path, i + 1, lines[i]));
  return evaluations;
}

std::string patterns_toml(const PatternTableHead& head, const std::vector<BestPattern>& best) {
  std::string text = head_line(head) + '\n';
  for (const BestPattern& b : best)
    text += fmt::format(
        "\n[[pattern]]\nzoom = {:#}\nkind = \"{}\"\ndistance_px = {}\ndot_px = {}\nseed = {}\n"
        "objective_mm = {:.4f}\nevaluations = {}\n",
        b.zoom, name(head.kind), b.dots.distance_px, b.dots.dot_px, head.seed, b.objective_mm,
        b.evaluations);
  return text;
}

}  // namespace holdfast::registration
