// SPDX-License-Identifier: Apache-2.0
#include "rt/study/study_row.hpp"

#include <array>
#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

using nlohmann::json;

struct Figure {
  const char* name;
  double StudyRow::*value;
};

constexpr std::array<Figure, 17> kFigures{
    {{"points", &StudyRow::points},
     {"density", &StudyRow::density},
     {"time_ms", &StudyRow::time_ms},
     {"fre_mm", &StudyRow::fre_mm},
     {"closest_mean_mm", &StudyRow::closest_mean_mm},
     {"closest_sd_mm", &StudyRow::closest_sd_mm},
     {"closest_rmse_mm", &StudyRow::closest_rmse_mm},
     {"closest_p95_mm", &StudyRow::closest_p95_mm},
     {"triangle_mean_mm", &StudyRow::triangle_mean_mm},
     {"triangle_median_mm", &StudyRow::triangle_median_mm},
     {"triangle_p95_mm", &StudyRow::triangle_p95_mm},
     {"coverage", &StudyRow::coverage},
     {"truth_median_mm", &StudyRow::truth_median_mm},
     {"truth_mean_mm", &StudyRow::truth_mean_mm},
     {"truth_p95_mm", &StudyRow::truth_p95_mm},
     {"truth_over_1_mm", &StudyRow::truth_over_1_mm},
     {"truth_over_1_mm_off_edges", &StudyRow::truth_over_1_mm_off_edges}}};

std::string quoted(const std::string& text) {
  std::string result = "\"";
  for (const char c : text) result += c == '"' ? std::string("\"\"") : std::string(1, c);
  return result + "\"";
}

}  // namespace

void StudyRow::judge(const DepthJudgement& truth) {
  coverage = truth.coverage;
  truth_median_mm = truth.median_mm;
  truth_mean_mm = truth.mean_mm;
  truth_p95_mm = truth.p95_mm;
  truth_over_1_mm = truth.share_over_1_mm;
  truth_over_1_mm_off_edges = truth.share_over_1_mm_off_edges;
}

std::string csv_text(const std::vector<StudyRow>& rows) {
  std::string text = "zoom,illumination,repeat,method";
  for (const Figure& figure : kFigures) text += fmt::format(",{}", figure.name);
  text += ",refusal\n";
  for (const StudyRow& row : rows) {
    text += fmt::format("{},{},{},{}", row.zoom, row.illumination, row.repeat, row.method);
    for (const Figure& figure : kFigures)
      text += std::isfinite(row.*figure.value) ? fmt::format(",{:.6g}", row.*figure.value) : ",";
    text += "," + (row.refusal.empty() ? "" : quoted(row.refusal)) + "\n";
  }
  return text;
}

json as_json(const StudyRow& row) {
  json result{{"zoom", row.zoom},
              {"illumination", row.illumination},
              {"repeat", row.repeat},
              {"method", row.method},
              {"refusal", row.refusal}};
  for (const Figure& figure : kFigures) {
    const double value = row.*figure.value;
    result[figure.name] = std::isfinite(value) ? json(value) : json(nullptr);
  }
  return result;
}

StudyRow row_of(const json& json) {
  try {
    StudyRow row;
    row.zoom = json.at("zoom").get<double>();
    row.illumination = json.at("illumination").get<std::string>();
    row.repeat = json.at("repeat").get<int>();
    row.method = json.at("method").get<std::string>();
    row.refusal = json.at("refusal").get<std::string>();
    for (const Figure& figure : kFigures)
      if (const auto& value = json.at(figure.name); !value.is_null())
        row.*figure.value = value.get<double>();
    return row;
  } catch (const nlohmann::json::exception& error) {
    throw InputError(fmt::format("no row of a study: {}", error.what()));
  }
}

StudyCell cell_of(const std::vector<StudyRow>& rows, double zoom, const std::string& illumination,
                  const std::string& method) {
  StudyCell cell;
  std::array<int, kFigures.size()> counts{};
  std::array<double, kFigures.size()> sums{};
  for (const StudyRow& row : rows) {
    if (row.zoom != zoom || row.illumination != illumination || row.method != method) continue;
    ++cell.repeats;
    if (!row.refusal.empty() && cell.refused++ == 0) cell.mean.refusal = row.refusal;
    for (std::size_t i = 0; i < kFigures.size(); ++i)
      if (const double value = row.*kFigures[i].value; std::isfinite(value)) {
        sums[i] += value;
        ++counts[i];
      }
  }
  cell.mean.zoom = zoom;
  cell.mean.illumination = illumination;
  cell.mean.method = method;
  for (std::size_t i = 0; i < kFigures.size(); ++i)
    if (counts[i] > 0) cell.mean.*kFigures[i].value = sums[i] / counts[i];
  return cell;
}

}  // namespace holdfast::rt
