// SPDX-License-Identifier: Apache-2.0
#include "rt/study/tracking_report.hpp"

#include <array>
#include <cmath>

#include <fmt/format.h>

#include "rt/study/study_report.hpp"

namespace holdfast::rt {
namespace {

struct Shown {
  const char *method, *label, *colour;
};
constexpr std::array<Shown, 3> kShown{{{"direct", "Holdfast", "#0b6e4f"},
                                       {"orb", "features alone, to the keyframe", "#2b59c3"},
                                       {"paper", "paper B's method", "#b5541c"}}};

/// Paper B, Table 1, as printed: mean and standard deviation, um.
struct Quoted {
  const char *scene, *specimen, *linear, *spiral;
};
constexpr std::array<Quoted, 3> kTable1{{{"cavity_bone", "TBP", "93.9 ± 118.4", "98.7 ± 79.0"},
                                         {"cavity_covered", "TBPs", "135.8 ± 114.3", "97.2 ± 85.9"},
                                         {"cavity_bloody", "CTP", "110.1 ± 112.6", "93.2 ± 80.0"}}};

/// Paper B, Table 2, 1920x1080, as printed: mean and standard deviation, ms.
struct QuotedStage {
  const char *name, *stage, *ms;
};
constexpr std::array<QuotedStage, 5> kTable2{{{"Preprocessing", "mask", "36 ± 9"},
                                              {"Feature detection", "detect", "74 ± 9"},
                                              {"Matching", "match", "16 ± 3"},
                                              {"Model estimation", "model", "246 ± 77"},
                                              {"Total", "total", "327"}}};

std::string number(double value, int decimals = 1) {
  return std::isfinite(value) ? fmt::format("{:.{}f}", value, decimals) : "–";
}

std::string cell(double value) {
  return std::isfinite(value) ? fmt::format("{:.5g}", value) : std::string();
}

const char* label_of(const std::string& method) {
  for (const Shown& shown : kShown)
    if (method == shown.method) return shown.label;
  return "";
}
const char* colour_of(const std::string& method) {
  for (const Shown& shown : kShown)
    if (method == shown.method) return shown.colour;
  return "#000";
}

std::string published(const TrackingRow& row) {
  for (const Quoted& quoted : kTable1)
    if (row.scene == quoted.scene && row.method == "paper") {
      if (row.motion == "linear") return quoted.linear;
      if (row.motion == "spiral") return quoted.spiral;
    }
  return "–";
}

double stage_ms(const TrackingRow& row, const std::string& name) {
  for (const StageTime& stage : row.stages)
    if (stage.name == name) return stage.median_ms;
  return std::nan("");
}

std::string heading(const TrackingSettings& settings, const TrackingResult& result) {
  std::string coverage;
  for (const auto& [scene, share] : result.depth_coverage)
    coverage +=
        fmt::format("{}{} {:.0f} %", coverage.empty() ? "" : ", ", escaped(scene), 100 * share);
  return fmt::format(
      "<h1>Following the site under the surgical microscope: a comparison</h1>\n"
      "<p class=\"w\"><b>Not for clinical use.</b> Everything here was measured on a simulated "
      "microscope. It says how the methods behave there, not how accurate they are on a "
      "patient.</p>\n<p>Each scene moves below the microscope as in the published experiment "
      "(2 mm/s), seen {:g} times a second at 1920×1080. Three methods follow the same frames. "
      "Holdfast's own uses the depth of the scene as it was reconstructed from one stereo pair "
      "under the dot pattern (known for this part of the frames: {}); the microscope was "
      "calibrated from {} views of a board ({} px rms). Errors are in the image plane, at the "
      "middle of the image, against the true motion.</p>\n",
      settings.rate_hz, coverage, settings.calibration_pairs, number(result.calibration_rms_px, 3));
}

std::string table1(const TrackingResult& result) {
  std::string html =
      "<h2>Errors (the published Table 1, beside ours)</h2>\n<table><tr><th>scene</th><th>motion"
      "</th><th>method</th><th>frame to frame, µm<br>mean ± SD</th><th>published, µm</th><th>since "
      "the keyframe,<br>rms, µm</th><th>largest, µm</th><th>depth, µm</th><th>rotation, mrad</th>"
      "<th>lost</th><th>silently wrong*</th></tr>\n";
  for (const TrackingRow& row : result.rows) {
    html += fmt::format("<tr><td>{}</td><td>{}</td><td>{}</td>", escaped(row.scene),
                        escaped(row.motion), label_of(row.method));
    if (!row.refusal.empty()) {
      html += fmt::format("<td colspan=\"8\">refused: {}</td></tr>\n", escaped(row.refusal));
      continue;
    }
    const TrackingJudgement& j = row.judged;
    html += fmt::format(
        "<td>{} ± {}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{} of {}</td>"
        "<td>{}</td></tr>\n",
        number(j.step_mean_um, 2), number(j.step_sd_um, 2), published(row),
        number(j.absolute_rms_um, 2), number(j.absolute_max_um), number(j.depth_rms_um),
        number(j.rotation_rms_mrad, 3), j.lost, j.frames, j.silently_wrong);
  }
  return html +
         "</table>\n<p>* frames that a method calls tracked while it is more than 200 µm "
         "off.</p>\n";
}

std::string table2(const TrackingResult& result) {
  std::string html =
      "<h2>Time a frame (the published Table 2, beside ours)</h2>\n<table><tr><th>step</th>"
      "<th>published, ms</th><th>its method here, median, ms</th></tr>\n";
  const TrackingRow *paper = nullptr, *direct = nullptr;
  for (const TrackingRow& row : result.rows) {
    if (row.method == "paper" && !row.stages.empty() && paper == nullptr) paper = &row;
    if (row.method == "direct" && !row.stages.empty() && direct == nullptr) direct = &row;
  }
  for (const QuotedStage& quoted : kTable2)
    html += fmt::format("<tr><td>{}</td><td>{}</td><td>{}</td></tr>\n", quoted.name, quoted.ms,
                        paper == nullptr ? "–" : number(stage_ms(*paper, quoted.stage)));
  html += "</table>\n";
  if (direct != nullptr)
    html += fmt::format(
        "<p>Holdfast's own, same scene and motion: {} ms, its check by features every third frame "
        "included. One thread, one run, whatever else the machine was doing; <code>./dev "
        "bench</code> compares them in turn.</p>\n",
        number(stage_ms(*direct, "total"), 2));
  return html;
}

std::string beam_table(const TrackingSettings& settings, const TrackingResult& result) {
  if (result.beam.empty()) return {};
  std::string html = fmt::format(
      "<h2>Where the beam lands</h2>\n<p>A simulated robot steers its beam by the poses that the "
      "control step permits (every millisecond, {:g} frames/s), with a dead time and a bandwidth "
      "of its own. Registration and hand-eye calibration are exact here, and the times that a "
      "network adds are set, not measured. Each motion begins with a second at rest. \"Lead\": "
      "how far ahead poses are predicted; none, or by what this robot follows late.</p>\n"
      "<table><tr><th>scene</th><th>motion</th><th>lead, ms</th><th>beam from target,<br>rms, µm"
      "</th><th>p99, µm</th><th>largest, µm</th><th>a beam that<br>stays, rms, µm</th>"
      "<th>permitted</th><th>stops</th></tr>\n",
      settings.beam_rate_hz);
  for (const BeamRow& row : result.beam) {
    html += fmt::format("<tr><td>{}</td><td>{}</td><td>{:.1f}</td>", escaped(row.scene),
                        escaped(row.motion), 1e-6 * static_cast<double>(row.lead.count()));
    if (!row.refusal.empty()) {
      html += fmt::format("<td colspan=\"6\">refused: {}</td></tr>\n", escaped(row.refusal));
      continue;
    }
    const BeamJudgement& j = row.judged;
    html += fmt::format(
        "<td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{:.1f} %</td><td>{}{}{}</td></tr>\n",
        number(j.rms_um, 2), number(j.p99_um), number(j.max_um), number(j.uncompensated_rms_um),
        100 * j.on_share, row.stops, row.stop_causes.empty() ? "" : ": ", row.stop_causes);
  }
  return html + "</table>\n";
}

std::string charts(const TrackingResult& result) {
  std::string fig6 = "<h2>Errors from frame to frame, µm (the published Fig. 6)</h2>\n",
              fig7 =
                  "<h2>Paths, mm (the published Fig. 7)</h2>\n<p>Grey: the true path; below it, as "
                  "each method has it.</p>\n";
  for (std::size_t i = 0; i < result.rows.size(); ++i) {
    const TrackingRow& row = result.rows[i];
    if (row.x_um.empty()) continue;
    const std::string title =
        fmt::format("{}, {}: {}", row.scene, row.motion, label_of(row.method));
    fig6 += plane_chart({title, false, {{colour_of(row.method), row.step_x_um, row.step_y_um, 0}}});
    PlaneSeries truth{"#b8c2cc", {}, {}, 6}, seen{colour_of(row.method), {}, {}, 1.5};
    for (std::size_t k = 0; k < row.x_um.size(); ++k) {
      truth.x.push_back(row.x_um[k] / 1000);
      truth.y.push_back(row.y_um[k] / 1000);
      seen.x.push_back((row.x_um[k] + row.error_x_um[k]) / 1000);
      seen.y.push_back((row.y_um[k] + row.error_y_um[k]) / 1000);
    }
    fig7 += plane_chart({title, true, {truth, seen}});
  }
  return fig6 + fig7;
}

}  // namespace

std::string tracking_csv(const TrackingResult& result) {
  std::string csv =
      "scene,motion,method,frames,lost,silently_wrong,step_mean_um,step_sd_um,absolute_rms_um,"
      "absolute_max_um,depth_rms_um,rotation_rms_mrad,frame_median_ms,refusal\n";
  for (const TrackingRow& row : result.rows) {
    const TrackingJudgement& j = row.judged;
    csv += fmt::format("{},{},{},{},{},{},{},{},{},{},{},{},{},{}\n", row.scene, row.motion,
                       row.method, j.frames, j.lost, j.silently_wrong, cell(j.step_mean_um),
                       cell(j.step_sd_um), cell(j.absolute_rms_um), cell(j.absolute_max_um),
                       cell(j.depth_rms_um), cell(j.rotation_rms_mrad),
                       cell(stage_ms(row, "total")), row.refusal);
  }
  return csv;
}

std::string beam_csv(const TrackingResult& result) {
  std::string csv =
      "scene,motion,lead_ms,on_s,on_share,rms_um,p99_um,max_um,uncompensated_rms_um,stops,"
      "stop_causes,refusal\n";
  for (const BeamRow& row : result.beam) {
    const BeamJudgement& j = row.judged;
    csv += fmt::format("{},{},{:.3f},{},{},{},{},{},{},{},{},{}\n", row.scene, row.motion,
                       1e-6 * static_cast<double>(row.lead.count()), cell(j.on_s), cell(j.on_share),
                       cell(j.rms_um), cell(j.p99_um), cell(j.max_um), cell(j.uncompensated_rms_um),
                       row.stops, row.stop_causes, row.refusal);
  }
  return csv;
}

std::string tracking_html(const TrackingSettings& settings, const TrackingResult& result) {
  return page_head("Holdfast: tracking study") + heading(settings, result) + table1(result) +
         table2(result) + beam_table(settings, result) + charts(result) +
         "<p>Every row is in <code>results.csv</code>, every frame's error in "
         "<code>SCENE/MOTION/METHOD_errors.csv</code> beside this page.</p>\n</body></html>\n";
}

}  // namespace holdfast::rt
