// SPDX-License-Identifier: Apache-2.0
// What the sealed files (registration, hand-eye calibration) have in common: strict reading of JSON
// members, and a SHA-256 over the content. For their .cpp files only: it brings in the JSON
// library.
#pragma once

#include <cmath>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <utility>

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace holdfast::registration {

/// A whole file; throws InputError when it cannot be read or is larger than `max_bytes`.
[[nodiscard]] std::string read_whole_file(const std::filesystem::path& file,
                                          std::uintmax_t max_bytes);

/// "sha256:" and 64 hex digits.
[[nodiscard]] std::string sha256(std::string_view bytes);

/// Discarded (`is_discarded()`) when it is no JSON or nested deeper than any of our files: copying
/// and printing a value descend into it, and the stack must hold that.
[[nodiscard]] nlohmann::json parse_json(std::string_view text);

/// Of the content without its member `checksum`.
[[nodiscard]] std::string seal_of(nlohmann::json content);

/// The JSON object in `file`, whose `checksum` is that of its content; throws InputError.
[[nodiscard]] nlohmann::json read_sealed(const std::filesystem::path& file);

/// Rows.
template <class Matrix>
[[nodiscard]] nlohmann::json matrix_json(const Matrix& matrix) {
  nlohmann::json rows = nlohmann::json::array();
  for (Eigen::Index r = 0; r < matrix.rows(); ++r) {
    nlohmann::json row = nlohmann::json::array();
    for (Eigen::Index c = 0; c < matrix.cols(); ++c) row.push_back(matrix(r, c));
    rows.push_back(row);
  }
  return rows;
}

/// Reads members of one JSON object; every failure names the file and the member.
class JsonReader {
 public:
  JsonReader(const nlohmann::json& object, std::string file)
      : object_(object), file_(std::move(file)) {}

  [[noreturn]] void fail(const std::string& what) const;
  [[nodiscard]] const nlohmann::json& member(const char* key) const;
  [[nodiscard]] bool has(const char* key) const;
  [[nodiscard]] double number(const char* key) const { return finite(member(key), key); }
  [[nodiscard]] std::string text(const char* key) const;
  /// Nested rows or one flat row-major list.
  template <int kRows, int kCols>
  [[nodiscard]] Eigen::Matrix<double, kRows, kCols> matrix(const char* key) const {
    const nlohmann::json& value = member(key);
    nlohmann::json flat = nlohmann::json::array();
    if (!value.is_array()) fail(fmt::format("{} is not a list", key));
    for (const nlohmann::json& item : value) {
      if (!item.is_array()) {
        flat.push_back(item);
        continue;
      }
      if (item.size() != kCols) fail(fmt::format("{} has a row without {} numbers", key, kCols));
      for (const nlohmann::json& number : item) flat.push_back(number);
    }
    if (flat.size() != kRows * kCols)
      fail(fmt::format("{} has {} numbers, not {}", key, flat.size(), kRows * kCols));
    Eigen::Matrix<double, kRows, kCols> matrix;
    std::size_t i = 0;
    for (int r = 0; r < kRows; ++r)
      for (int c = 0; c < kCols; ++c) matrix(r, c) = finite(flat.at(i++), key);
    return matrix;
  }

 private:
  double finite(const nlohmann::json& value, const char* key) const;
  const nlohmann::json& object_;
  std::string file_;
};

/// Symmetric and positive semi-definite, or reader.fail().
template <int kSize>
void require_covariance(const Eigen::Matrix<double, kSize, kSize>& covariance, const char* key,
                        const JsonReader& reader) {
  const double scale = covariance.cwiseAbs().maxCoeff();
  if ((covariance - covariance.transpose()).cwiseAbs().maxCoeff() > 1e-9 * scale)
    reader.fail(fmt::format("{} is not symmetric", key));
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, kSize, kSize>> solver(
      covariance, Eigen::EigenvaluesOnly);
  if (solver.eigenvalues().minCoeff() < -1e-9 * scale)
    reader.fail(fmt::format("{} is not positive semi-definite, smallest eigenvalue {}", key,
                            solver.eigenvalues().minCoeff()));
}

/// A rotation to 1e-6 and a last row 0 0 0 1, or reader.fail().
[[nodiscard]] Eigen::Isometry3d require_pose(const Eigen::Matrix4d& matrix, const char* key,
                                             const JsonReader& reader);

}  // namespace holdfast::registration
