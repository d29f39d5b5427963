// SPDX-License-Identifier: Apache-2.0
// A CSV file with a header line, read whole; cells by column name.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace holdfast::sim {

class CsvTable {
 public:
  /// A last line without its end (the writer was killed) is left out. Throws InputError.
  explicit CsvTable(const std::filesystem::path& file);
  [[nodiscard]] std::size_t rows() const noexcept { return cells_.size(); }
  /// Throws InputError naming the file when it has no such column.
  [[nodiscard]] std::size_t column(std::string_view name) const;
  [[nodiscard]] const std::string& text(std::size_t row, std::size_t column) const;
  /// NaN when the cell is empty.
  [[nodiscard]] double number(std::size_t row, std::size_t column) const;
  /// 0 when the cell is empty.
  [[nodiscard]] std::int64_t integer(std::size_t row, std::size_t column) const;

 private:
  std::filesystem::path file_;
  std::vector<std::string> header_;
  std::vector<std::vector<std::string>> cells_;
};

}  // namespace holdfast::sim
