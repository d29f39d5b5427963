// SPDX-License-Identifier: Apache-2.0
// One reconstruction of the study: a row of its CSV, kept as a small file so that a study can be
// taken up again.
#pragma once

#include <limits>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "rt/study/rig.hpp"

namespace holdfast::rt {

struct StudyRow {
  static constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();

  double zoom = 0;
  std::string illumination;  ///< name(Illumination)
  int repeat = 0;
  std::string method;  ///< sgm (ours) or opencv (SGBM)
  /// Why it would be refused in use; empty: it would not. What can be measured is all the same.
  std::string refusal;

  double points = kUnknown, density = kUnknown, time_ms = kUnknown;
  double fre_mm = kUnknown;
  /// To the CT after registration by the fiducials alone: nearest vertex (the paper's metric; its
  /// "RMSE" is this mean), and nearest point of the triangles.
  double closest_mean_mm = kUnknown, closest_sd_mm = kUnknown, closest_rmse_mm = kUnknown,
         closest_p95_mm = kUnknown;
  double triangle_mean_mm = kUnknown, triangle_median_mm = kUnknown, triangle_p95_mm = kUnknown;
  /// Against what the microscope truly saw, by the rig's own judge.
  double coverage = kUnknown, truth_median_mm = kUnknown, truth_mean_mm = kUnknown,
         truth_p95_mm = kUnknown, truth_over_1_mm = kUnknown,
         truth_over_1_mm_off_edges = kUnknown;  ///< shares, 0..1
  void judge(const DepthJudgement& truth);
};

/// A header and a line each; what is unknown is empty, text is quoted.
[[nodiscard]] std::string csv_text(const std::vector<StudyRow>& rows);
[[nodiscard]] nlohmann::json as_json(const StudyRow& row);  ///< unknown: null
/// Throws InputError for anything that as_json() did not write.
[[nodiscard]] StudyRow row_of(const nlohmann::json& json);

/// Rows of one zoom, illumination and method as one: means over the repeats that have the figure.
struct StudyCell {
  int repeats = 0, refused = 0;
  StudyRow mean;  ///< `refusal`: the first one
};
[[nodiscard]] StudyCell cell_of(const std::vector<StudyRow>& rows, double zoom,
                                const std::string& illumination, const std::string& method);

}  // namespace holdfast::rt
