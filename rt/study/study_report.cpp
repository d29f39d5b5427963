// SPDX-License-Identifier: Apache-2.0
#include "rt/study/study_report.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include <fmt/format.h>

#include "registration/pattern_table.hpp"
#include "rt/study/illumination.hpp"

namespace holdfast::rt {
namespace {

struct Shown {
  Illumination illumination;
  const char* label;
  const char* colour;
};
constexpr std::array<Shown, 4> kShown{{{Illumination::adaptive, "adaptive pattern", "#0b6e4f"},
                                       {Illumination::random, "random pattern", "#b5541c"},
                                       {Illumination::or_light, "OR light", "#2b59c3"},
                                       {Illumination::microscope, "microscope light", "#8a4fa3"}}};

/// Paper A, Table 2, as printed. Its column for the microscope's light is not in the text we have.
struct Quoted {
  double zoom;
  const char *adaptive, *random, *or_light;
};
constexpr std::array<Quoted, 5> kPaper{{{1.1, "0.7 ± 0.4", "1.9 ± 1.8", "1 ± 0.9"},
                                        {1.2, "0.7 ± 0.4", "1.7 ± 1.7", "1.2 ± 1"},
                                        {1.3, "0.5 ± 0.3", "1.8 ± 1.8", "1.1 ± 1.0"},
                                        {1.4, "0.5 ± 0.3", "1.5 ± 1.6", "1.8 ± 1.5"},
                                        {1.5, "0.5 ± 0.3", "1.6 ± 1.7", "1.7 ± 1.4"}}};

std::string quoted(double zoom, Illumination illumination) {
  for (const Quoted& row : kPaper) {
    if (std::abs(row.zoom - zoom) > 1e-6) continue;
    if (illumination == Illumination::adaptive) return row.adaptive;
    if (illumination == Illumination::random) return row.random;
    if (illumination == Illumination::or_light) return row.or_light;
  }
  return "–";
}

std::string number(double value, int decimals = 2) {
  return std::isfinite(value) ? fmt::format("{:.{}f}", value, decimals) : "–";
}
std::string percent(double share, int decimals = 1) {
  return std::isfinite(share) ? fmt::format("{:.{}f} %", 100 * share, decimals) : "–";
}

/// Under the adaptive pattern: median distance to the CT's surface, and share of points more than
/// 1 mm wrong away from depth edges.
struct Aim {
  double median_mm, wrong;
};
constexpr Aim kSingleAim{0.06, 0.01}, kBurstAim{0.045, 0.001};

std::string marked(const std::string& text, bool is_missed) {
  return is_missed ? "<b class=\"m\">" + text + "</b>" : text;
}

std::string refused(const StudyCell& cell) {
  return cell.refused > 0
             ? fmt::format(" <small>({} of {} refused)</small>", cell.refused, cell.repeats)
             : std::string();
}

/// What is shown of a cell depends on how much of it was refused.
std::string mean_sd(const StudyCell& cell) {
  const std::string figure =
      std::isfinite(cell.mean.closest_mean_mm)
          ? number(cell.mean.closest_mean_mm) + " ± " + number(cell.mean.closest_sd_mm)
          : "–";
  return figure + refused(cell);
}

std::string burst_row(double zoom, const std::string& pictures, const StudyCell& cell,
                      const Aim& aim) {
  const StudyRow& row = cell.mean;
  return fmt::format(
      "<tr><td>{:g}</td><td>{}{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td>"
      "<td>{}</td><td>{}</td><td>{}</td></tr>\n",
      zoom, pictures, refused(cell), number(row.triangle_mean_mm, 3),
      marked(number(row.triangle_median_mm, 3), row.triangle_median_mm > aim.median_mm),
      number(row.truth_median_mm, 3), number(row.truth_p95_mm), percent(row.truth_over_1_mm, 2),
      marked(percent(row.truth_over_1_mm_off_edges, 2), row.truth_over_1_mm_off_edges > aim.wrong),
      percent(row.coverage), number(row.time_ms, 0));
}

class Page {
 public:
  Page(const StudySettings& settings, const std::vector<StudyRow>& rows)
      : settings_(settings), rows_(rows) {}

  [[nodiscard]] StudyCell cell(double zoom, Illumination illumination, const char* method) const {
    return cell_of(rows_, zoom, std::string(name(illumination)), method);
  }

  [[nodiscard]] std::string heading(double calibration_rms_px) const {
    return fmt::format(
        "<h1>Surface reconstruction under the surgical microscope: a comparison</h1>\n"
        "<p class=\"w\"><b>Not for clinical use.</b> Everything here was measured on a simulated "
        "microscope and a simulated plastic ear. It says how the method behaves there, not how "
        "accurate it is on a patient.</p>\n"
        "<p>A model of an ear was placed under a stereo microscope at {} zoom level{}, under four "
        "kinds of light, {} time{} each in another position. From each pair of images its surface "
        "was computed twice: by Holdfast and by OpenCV's semi-global matcher (SGBM), which is what "
        "the published study used. Each surface was laid onto the CT by four markers alone and "
        "{} of its points compared with it. {} reconstructions; microscope calibrated to {} px "
        "(rms, worst zoom); rig <code>{}</code>. Ear shapes (--phantom-seed) from 1000 on are kept "
        "for evaluation: "
        "every setting was written down (<code>study.json</code>) before their first image was "
        "made.</p>\n",
        settings_.zooms.size(), settings_.zooms.size() == 1 ? "" : "s", settings_.repeats,
        settings_.repeats == 1 ? "" : "s", settings_.points, rows_.size(),
        number(calibration_rms_px, 3), escaped(rig_text(settings_.rig)));
  }

  [[nodiscard]] std::string table2() const {
    std::string html =
        "<h2>Distance to the CT (the published Table 2, beside ours)</h2>\n<p>Mean ± standard "
        "deviation of the distance from a reconstructed point to the nearest point of the CT, mm. "
        "<span class=\"q\">Italics: quoted from the paper</span>, measured there on another ear "
        "and microscope. <b>A small distance to the nearest point does not mean that a point is in "
        "the right place</b>: a wrong point is always near something. The next table says how "
        "wrong the points are.</p>\n<table><tr><th>zoom</th><th>light</th><th>paper</th><th>"
        "OpenCV SGBM</th><th>Holdfast</th><th>Holdfast, to the CT's surface</th></tr>\n";
    for (const double zoom : settings_.zooms)
      for (const Shown& shown : kShown) {
        const StudyCell ours = cell(zoom, shown.illumination, "sgm");
        html += fmt::format(
            "<tr><td>{:g}</td><td>{}</td><td class=\"q\">{}</td><td>{}</td><td>{}</td><td>{}</td>"
            "</tr>\n",
            zoom, shown.label, quoted(zoom, shown.illumination),
            mean_sd(cell(zoom, shown.illumination, "opencv")), mean_sd(ours),
            number(ours.mean.triangle_mean_mm));
      }
    return html + "</table>\n";
  }

  [[nodiscard]] std::string truth_table() const {
    std::string html =
        "<h2>Error against the truth</h2>\n<p>The simulator knows what each pixel saw. For every "
        "pixel of the ear that both cameras see: how far the reconstructed point is from the true "
        "one (mm), the share of points more than 1 mm wrong (in all, and away from depth edges), "
        "and the share of the ear that was reconstructed at all. The calibration's own error is in "
        "it; the registration's is not. First OpenCV's, then Holdfast's figure.</p>\n<table><tr>"
        "<th>zoom</th><th>light</th><th>median</th><th>95 %</th><th>over 1 mm</th><th>over 1 mm, "
        "off edges</th><th>covered</th><th>time, ms</th></tr>\n";
    for (const double zoom : settings_.zooms)
      for (const Shown& shown : kShown) {
        const StudyRow theirs = cell(zoom, shown.illumination, "opencv").mean,
                       ours = cell(zoom, shown.illumination, "sgm").mean;
        const auto both = [&](double StudyRow::*figure, bool is_share) {
          return is_share ? percent(theirs.*figure) + " / " + percent(ours.*figure)
                          : number(theirs.*figure) + " / " + number(ours.*figure);
        };
        html += fmt::format(
            "<tr><td>{:g}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td>"
            "<td>{} / {}</td></tr>\n",
            zoom, shown.label, both(&StudyRow::truth_median_mm, false),
            both(&StudyRow::truth_p95_mm, false), both(&StudyRow::truth_over_1_mm, true),
            both(&StudyRow::truth_over_1_mm_off_edges, true), both(&StudyRow::coverage, true),
            number(theirs.time_ms, 0), number(ours.time_ms, 0));
      }
    return html + "</table>\n";
  }

  /// Empty where no burst was taken.
  [[nodiscard]] std::string burst_table() const {
    if (settings_.shots < 2) return {};
    std::string html = fmt::format(
        "<h2>A burst beside the single shot</h2>\n<p>A registration is made at rest, so there is "
        "time for more than one picture: {} pairs of the same ear in the same position, each under "
        "adaptive dots of its own, were reconstructed together. Holdfast's figures under the "
        "adaptive pattern, mm: distance to the CT's surface, and error against the truth. Aims: "
        "median distance to the CT's surface at most {} mm of a single shot and {} mm of a burst, "
        "points more than 1 mm wrong away from depth edges at most {} and {}. <b class=\"m\">What "
        "misses its aim is marked so.</b></p>\n<table><tr><th>zoom</th><th>pictures</th><th>to the "
        "CT: mean</th><th>median</th><th>to the truth: median</th><th>95 %</th><th>over 1 mm</th>"
        "<th>over 1 mm, off edges</th><th>covered</th><th>time, ms</th></tr>\n",
        settings_.shots, kSingleAim.median_mm, kBurstAim.median_mm, percent(kSingleAim.wrong),
        percent(kBurstAim.wrong));
    for (const double zoom : settings_.zooms) {
      html += burst_row(zoom, "single shot", cell(zoom, Illumination::adaptive, "sgm"), kSingleAim);
      html += burst_row(zoom, fmt::format("burst of {}", settings_.shots),
                        cell(zoom, Illumination::adaptive, "burst"), kBurstAim);
    }
    return html + "</table>\n";
  }

  [[nodiscard]] std::string charts() const {
    std::string html = "<h2>Over the zoom</h2>\n";
    const auto chart = [&](const char* title, const char* method, double StudyRow::*figure,
                           double factor) {
      std::vector<ZoomLine> lines;
      for (const Shown& shown : kShown) {
        ZoomLine line{shown.label, shown.colour, {}};
        for (const double zoom : settings_.zooms)
          line.y.push_back(factor * cell(zoom, shown.illumination, method).mean.*figure);
        lines.push_back(line);
      }
      html += zoom_chart(title, settings_.zooms, lines);
    };
    chart("Holdfast: mean distance to the nearest CT point, mm", "sgm", &StudyRow::closest_mean_mm,
          1);
    chart("OpenCV: mean distance to the nearest CT point, mm", "opencv", &StudyRow::closest_mean_mm,
          1);
    chart("Holdfast: points more than 1 mm wrong, %", "sgm", &StudyRow::truth_over_1_mm, 100);
    chart("OpenCV: points more than 1 mm wrong, %", "opencv", &StudyRow::truth_over_1_mm, 100);
    return html;
  }

  [[nodiscard]] std::string patterns() const {
    std::string html =
        "<h2>Patterns (the published Table 1)</h2>\n<p>The adaptive pattern at each zoom: the "
        "diameter of a dot and the gap between dots, in pixels of the 800×600 projector. The "
        "paper's own Table 1 is not in the text that we have.</p>\n<table><tr><th>zoom</th><th>"
        "dot s</th><th>distance d</th><th>kind</th></tr>\n";
    for (std::size_t i = 0; i < settings_.zooms.size() && i < settings_.patterns.size(); ++i) {
      const registration::PatternParameters& p = settings_.patterns[i];
      html += fmt::format("<tr><td>{:g}</td><td>{:g}</td><td>{:g}</td><td>{}</td></tr>\n",
                          settings_.zooms[i], p.dot_px, p.distance_px, registration::name(p.kind));
    }
    return html + "</table>\n";
  }

  [[nodiscard]] std::string refusals() const {
    std::map<std::string, int> reasons;
    for (const StudyRow& row : rows_)
      if (!row.refusal.empty())
        ++reasons[fmt::format("{}, {}: {}", row.illumination, row.method, row.refusal)];
    std::string html = "<h2>Refused</h2>\n";
    if (reasons.empty()) return html + "<p>Nothing was refused.</p>\n";
    html +=
        "<p>What cannot be trusted is refused in use. So that neither method gains by refusing, "
        "whatever such a reconstruction still holds is measured above, counted as refused; where "
        "a figure is missing (–) there was nothing to measure. Holdfast looks for places that fit "
        "as well elsewhere along the rows (<i>period slip</i>): a repeating pattern has them, and "
        "so has a surface without a pattern whose own texture is faint. OpenCV asks no such "
        "question.</p>\n<ul>\n";
    for (const auto& [reason, count] : reasons)
      html += fmt::format("<li>{} × {}</li>\n", count, escaped(reason));
    return html + "</ul>\n";
  }

 private:
  const StudySettings& settings_;
  const std::vector<StudyRow>& rows_;
};

std::string limits() {
  return "<h2>Limits</h2>\n<ul>\n"
         "<li>A simulation shares its authors' idea of what matters. Contrast of the surface, "
         "speckle and the light's power change the order of the four kinds of light; only one "
         "setting of them is shown here.</li>\n"
         "<li>The ear is matt plastic. Skin and wet bone scatter the pattern inside; on them the "
         "best dots are coarser and all errors larger.</li>\n"
         "<li>The paper's ear, microscope and matcher settings differ from ours. Its figures are "
         "quoted, not reproduced: compare trends, and compare Holdfast with OpenCV, which saw the "
         "same images.</li>\n"
         "<li>Distances to the nearest CT vertex have a floor set by the CT's 0.6 mm slices; the "
         "column to the CT's surface has not. Both hold the error of the registration by four "
         "markers.</li>\n"
         "<li>The region judged against the CT lies between the four markers, 9 mm away from "
         "each; that against the truth is the ear itself.</li>\n"
         "<li>Times are of this machine, one reconstruction each, whatever else it was "
         "doing.</li>\n</ul>\n";
}

}  // namespace

std::string study_html(const StudySettings& settings, const std::vector<StudyRow>& rows,
                       double calibration_rms_px, const std::vector<ReportPicture>& heat_maps) {
  const Page page(settings, rows);
  std::string html = page_head("Holdfast: study");
  html += page.heading(calibration_rms_px) + page.table2() + page.truth_table() +
          page.burst_table() + page.charts() + page.patterns();
  if (!heat_maps.empty())
    html +=
        "<h2>Where the errors are (the published Fig. 7)</h2>\n<p>Seen along the direction of "
        "view: distance to the CT's surface, 0 to 1 mm. Grey: nothing reconstructed.</p>\n";
  for (const ReportPicture& picture : heat_maps)
    html += fmt::format(
        "<figure><img alt=\"{0}\" src=\"data:image/png;base64,{1}\"><figcaption>{0}</figcaption>"
        "</figure>\n",
        escaped(picture.title), base64(picture.png));
  return html + page.refusals() + limits() +
         "<p>Every reconstruction is a row of <code>results.csv</code> beside this page.</p>\n"
         "</body></html>\n";
}

}  // namespace holdfast::rt
