// SPDX-License-Identifier: Apache-2.0
// The study as one page that a surgeon can read and an engineer can check: no script, no other
// file, pictures inside.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "rt/study/study.hpp"

namespace holdfast::rt {

struct ReportPicture {
  std::string title;
  std::string png;  ///< the file's bytes
};

/// Self-contained HTML. Pure: same input, same bytes.
[[nodiscard]] std::string study_html(const StudySettings& settings,
                                     const std::vector<StudyRow>& rows, double calibration_rms_px,
                                     const std::vector<ReportPicture>& heat_maps);

/// Lines over the zooms, as an inline SVG. NaN: no point.
struct ZoomLine {
  std::string label, colour;
  std::vector<double> y;
};
[[nodiscard]] std::string zoom_chart(const std::string& title, const std::vector<double>& zooms,
                                     const std::vector<ZoomLine>& lines);

/// Two lengths against each other, both axes alike and through zero (y down, as in an image).
struct PlaneSeries {
  std::string colour;
  std::vector<double> x, y;
  double width = 2;
};
struct PlaneChart {
  std::string title;
  bool is_line = true;  ///< else points
  std::vector<PlaneSeries> series;
};
[[nodiscard]] std::string plane_chart(const PlaneChart& chart);

/// From the doctype to the opened body.
[[nodiscard]] std::string page_head(const std::string& title);
/// Text for HTML.
[[nodiscard]] std::string escaped(const std::string& text);
[[nodiscard]] std::string base64(const std::string& bytes);

}  // namespace holdfast::rt
