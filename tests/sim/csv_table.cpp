// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/csv_table.hpp"

#include <algorithm>
#include <charconv>
#include <cstdlib>
#include <fstream>
#include <limits>
#include <sstream>

#include <fmt/format.h>

#include "rt/core/error.hpp"

namespace holdfast::sim {
namespace {

/// A cell in double quotes may hold commas; quotes inside quotes do not occur in our files.
std::vector<std::string> split(const std::string& line) {
  std::vector<std::string> cells(1);
  bool is_quoted = false;
  for (const char c : line) {
    if (c == '"')
      is_quoted = !is_quoted;
    else if (c == ',' && !is_quoted)
      cells.emplace_back();
    else
      cells.back() += c;
  }
  return cells;
}

}  // namespace

CsvTable::CsvTable(const std::filesystem::path& file) : file_(file) {
  std::ifstream stream{file};
  std::ostringstream whole;
  whole << stream.rdbuf();
  if (!stream) throw InputError(fmt::format("{}: cannot be read", file.string()));
  const std::string text = whole.str();
  std::size_t begin = 0;
  for (std::size_t end = text.find('\n'); end != std::string::npos; end = text.find('\n', begin)) {
    std::vector<std::string> cells = split(text.substr(begin, end - begin));
    begin = end + 1;
    if (header_.empty()) {
      header_ = std::move(cells);
      continue;
    }
    if (cells.size() != header_.size())
      throw InputError(fmt::format("{}: line {} has {} cells, not {}", file.string(),
                                   cells_.size() + 2, cells.size(), header_.size()));
    cells_.push_back(std::move(cells));
  }
  if (header_.empty()) throw InputError(fmt::format("{}: has no header line", file.string()));
}

std::size_t CsvTable::column(std::string_view name) const {
  const auto found = std::find(header_.begin(), header_.end(), name);
  if (found == header_.end())
    throw InputError(fmt::format("{}: no column {}", file_.string(), name));
  return static_cast<std::size_t>(found - header_.begin());
}

const std::string& CsvTable::text(std::size_t row, std::size_t column) const {
  return cells_.at(row).at(column);
}

double CsvTable::number(std::size_t row, std::size_t column) const {
  const std::string& cell = text(row, column);
  return cell.empty() ? std::numeric_limits<double>::quiet_NaN()
                      : std::strtod(cell.c_str(), nullptr);
}

std::int64_t CsvTable::integer(std::size_t row, std::size_t column) const {
  const std::string& cell = text(row, column);
  std::int64_t value = 0;
  std::from_chars(cell.data(), cell.data() + cell.size(), value);
  return value;
}

}  // namespace holdfast::sim
