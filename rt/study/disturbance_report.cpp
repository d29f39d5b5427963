// SPDX-License-Identifier: Apache-2.0
// The disturbances as a table and one self-contained page.
#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "rt/study/disturbance_study.hpp"
#include "rt/study/study_report.hpp"

namespace holdfast::rt {
namespace {

constexpr const char* kStatuses[] = {"tracking", "relocalised", "degraded", "lost"};

int count_of(const std::map<std::string, int>& counts, const std::string& name) {
  const auto found = counts.find(name);
  return found == counts.end() ? 0 : found->second;
}

std::string number(double value, int digits) {
  return std::isfinite(value) ? fmt::format("{:.{}f}", value, digits) : std::string("–");
}

std::string cell(double value) {
  return std::isfinite(value) ? fmt::format("{:.5g}", value) : std::string();
}

const char* colour_of(const std::string& status) {
  if (status == "tracking") return "#0b6e4f";
  return status == "relocalised" ? "#2b59c3" : "#d99b00";
}

/// Error over time, one dot a pose, on a logarithmic axis from .01 um to 10 mm.
std::string error_chart(const DisturbanceRow& row) {
  constexpr double kWidth = 640, kHeight = 150, kLeft = 56, kTop = 24, kBottom = 20;
  constexpr double kLeast = -2, kMost = 4;  // powers of ten, um
  double t_last = 1e-9;
  for (const DisturbedFrame& f : row.poses) t_last = std::max(t_last, f.t_s);
  const auto py = [&](double um) {
    const double share = (std::log10(std::clamp(um, 1e-2, 1e4)) - kLeast) / (kMost - kLeast);
    return kHeight - kBottom - share * (kHeight - kTop - kBottom);
  };
  std::string svg = fmt::format(
      "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {}\" role=\"img\" "
      "aria-label=\"{}\"><text x=\"{}\" y=\"15\" class=\"t\">{}, {}: error, µm, over {:.1f} "
      "s</text>\n",
      kWidth, kHeight, escaped(row.name), kLeft, escaped(row.scene), escaped(row.name), t_last);
  for (const double um : {0.1, 1.0, 10.0, 100.0, 1000.0})
    svg += fmt::format(
        "<line x1=\"{0}\" x2=\"{1}\" y1=\"{2:.1f}\" y2=\"{2:.1f}\" class=\"g\"/><text x=\"{3}\" "
        "y=\"{4:.1f}\" text-anchor=\"end\">{5:g}</text>\n",
        kLeft, kWidth, py(um), kLeft - 6, py(um) + 4, um);
  for (const DisturbedFrame& f : row.poses)
    svg += fmt::format("<circle cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"2\" fill=\"{}\"/>",
                       kLeft + f.t_s / t_last * (kWidth - kLeft - 4), py(f.error_um),
                       colour_of(f.status));
  return svg + "</svg>\n";
}

std::string table_row(const DisturbanceRow& row) {
  std::string html =
      fmt::format("<tr><td>{}</td><td>{}</td>", escaped(row.scene), escaped(row.name));
  if (!row.refusal.empty())
    return html + fmt::format("<td colspan=\"12\">refused: {}</td></tr>\n", escaped(row.refusal));
  html += fmt::format("<td>{}</td><td>{}</td>", row.frames, row.voided);
  const int told = std::max(1, row.frames - row.voided);
  for (const char* status : kStatuses)
    html += fmt::format("<td>{:.1f}</td>", 100.0 * count_of(row.statuses, status) / told);
  html += fmt::format("<td>{}</td><td>{}</td><td><b>{}</b></td><td>{}</td><td>{}</td>",
                      number(row.rms_um, 2), number(row.max_um, 1), row.silently_wrong,
                      number(row.nees_mean, 1), number(100 * row.nees_share_in_95, 0));
  const std::string found =
      row.frames_until_found
          ? fmt::format("{} ({:.1f} ms)", *row.frames_until_found, row.found_in_ms)
          : "–";
  return html + fmt::format("<td>{}</td></tr>\n", found);
}

}  // namespace

std::string disturbance_csv(const DisturbanceResult& result) {
  std::string csv =
      "scene,disturbance,frames,voided,tracking,relocalised,degraded,lost,rms_um,max_um,"
      "plane_rms_um,silently_wrong,nees_mean,nees_share_in_95,frames_until_found,found_in_ms,"
      "refusal\n";
  for (const DisturbanceRow& row : result.rows) {
    csv += fmt::format("{},{},{},{}", row.scene, row.name, row.frames, row.voided);
    for (const char* status : kStatuses) csv += fmt::format(",{}", count_of(row.statuses, status));
    csv += fmt::format(",{},{},{},{},{},{}", cell(row.rms_um), cell(row.max_um),
                       cell(row.plane_rms_um), row.silently_wrong, cell(row.nees_mean),
                       cell(row.nees_share_in_95));
    csv += row.frames_until_found
               ? fmt::format(",{},{}", *row.frames_until_found, cell(row.found_in_ms))
               : std::string(",,");
    csv += "," + row.refusal + "\n";
  }
  return csv;
}

std::string disturbance_html(const DisturbanceSettings& settings, const DisturbanceResult& result) {
  std::string html =
      page_head("Holdfast: disturbances") +
      fmt::format(
          "<h1>What the tracker says while something goes wrong</h1>\n<p class=\"w\"><b>Not for "
          "clinical use.</b> Everything here was measured on a simulated microscope.</p>\n<p>{:g} "
          "frames a second of 1920×1080 at zoom {:g}, followed by Holdfast's direct tracker with "
          "the depth that was reconstructed from one stereo pair. Errors are in all three "
          "directions, at the site point in the image's middle, of the frames called tracking or "
          "relocalised. Silently wrong: of these more than {:g} µm off. Void: taken at a zoom that "
          "the encoder says is not the keyframe's; the daemon uses none of their estimates. The "
          "normalised error squared has six freedoms: 6 is exact, and 95 % should be below "
          "{:.1f}; errors of one sequence share those of its depth map.</p>\n",
          settings.rate_hz, settings.zoom, kSilentlyWrongUm, kChiSquared6Bound95);
  html +=
      "<table><tr><th>scene</th><th>disturbance</th><th>frames</th><th>void</th><th>tracking, %"
      "</th><th>relocalised</th><th>degraded</th><th>lost</th><th>error, rms, µm</th><th>largest"
      "</th><th>silently wrong</th><th>normalised error<br>squared, mean</th><th>in its 95 %, %"
      "</th><th>found again after<br>clear frames</th></tr>\n";
  for (const DisturbanceRow& row : result.rows) html += table_row(row);
  html += "</table>\n<p>Dots: tracking green, relocalised blue, degraded yellow.</p>\n";
  for (const DisturbanceRow& row : result.rows)
    if (row.refusal.empty()) html += error_chart(row);
  return html + "</body></html>\n";
}

}  // namespace holdfast::rt
