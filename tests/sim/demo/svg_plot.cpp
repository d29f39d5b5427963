// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/demo/svg_plot.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

#include <fmt/format.h>

namespace holdfast::sim {
namespace {

constexpr double kLeft = 70, kRight = 20, kTop = 34, kBottom = 50;

struct Axis {
  double min = std::numeric_limits<double>::infinity();
  double max = -std::numeric_limits<double>::infinity();
  double from_px = 0, to_px = 1;

  void include(double value) {
    if (!std::isfinite(value)) return;
    min = std::min(min, value);
    max = std::max(max, value);
  }
  void pad() {
    if (!(min <= max)) min = 0, max = 1;
    const double margin = max > min ? 0.04 * (max - min) : 1;
    min -= margin;
    max += margin;
  }
  [[nodiscard]] double px(double value) const {
    return from_px + (value - min) / (max - min) * (to_px - from_px);
  }
  [[nodiscard]] double step() const {
    const double raw = (max - min) / 6;
    const double decade = std::pow(10, std::floor(std::log10(raw)));
    for (const double factor : {1.0, 2.0, 5.0})
      if (factor * decade >= raw) return factor * decade;
    return 10 * decade;
  }
};

std::string escaped(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (c == '<')
      out += "&lt;";
    else if (c == '&')
      out += "&amp;";
    else
      out += c;
  }
  return out;
}

/// Widens the axis with fewer units per pixel until both have as many.
void equalise(Axis& x, Axis& y) {
  const double x_unit = (x.max - x.min) / std::abs(x.to_px - x.from_px);
  const double y_unit = (y.max - y.min) / std::abs(y.to_px - y.from_px);
  Axis& narrow = x_unit < y_unit ? x : y;
  const double wanted = std::max(x_unit, y_unit) * std::abs(narrow.to_px - narrow.from_px);
  const double extra = (wanted - (narrow.max - narrow.min)) / 2;
  narrow.min -= extra;
  narrow.max += extra;
}

std::string ticks(const Axis& x, const Axis& y) {
  std::string svg;
  for (double v = std::ceil(x.min / x.step()) * x.step(); v <= x.max; v += x.step())
    svg += fmt::format(
        "<line x1='{0:.1f}' y1='{1:.1f}' x2='{0:.1f}' y2='{2:.1f}' stroke='#e3e3e3'/>"
        "<text x='{0:.1f}' y='{3:.1f}' text-anchor='middle'>{4:g}</text>\n",
        x.px(v), y.from_px, y.to_px, y.from_px + 16, std::abs(v) < 1e-9 * x.step() ? 0.0 : v);
  for (double v = std::ceil(y.min / y.step()) * y.step(); v <= y.max; v += y.step())
    svg += fmt::format(
        "<line x1='{1:.1f}' y1='{0:.1f}' x2='{2:.1f}' y2='{0:.1f}' stroke='#e3e3e3'/>"
        "<text x='{3:.1f}' y='{4:.1f}' text-anchor='end'>{5:g}</text>\n",
        y.px(v), x.from_px, x.to_px, x.from_px - 6, y.px(v) + 4,
        std::abs(v) < 1e-9 * y.step() ? 0.0 : v);
  return svg;
}

std::string path(const PlotSeries& series, const Axis& x, const Axis& y) {
  std::string d;
  bool is_pen_down = false;
  for (std::size_t i = 0; i < std::min(series.x.size(), series.y.size()); ++i) {
    if (!std::isfinite(series.x[i]) || !std::isfinite(series.y[i])) {
      is_pen_down = false;
      continue;
    }
    d += fmt::format("{}{:.1f} {:.1f}", is_pen_down ? "L" : "M", x.px(series.x[i]),
                     y.px(series.y[i]));
    is_pen_down = true;
  }
  return fmt::format("<path d='{}' fill='none' stroke='{}' stroke-width='1.4'/>\n", d,
                     series.colour);
}

std::string legend_entry(double& at_px, const std::string& colour, const std::string& label) {
  std::string svg = fmt::format(
      "<rect x='{:.0f}' y='{:.0f}' width='12' height='10' fill='{}'/><text x='{:.0f}' y='{:.0f}'>{}"
      "</text>\n",
      at_px, kTop - 14, colour, at_px + 16, kTop - 5, escaped(label));
  at_px += 34 + 6.6 * static_cast<double>(label.size());
  return svg;
}

}  // namespace

std::string to_svg(const Plot& plot) {
  Axis x, y;
  for (const PlotSeries& series : plot.series) {
    for (const double value : series.x) x.include(value);
    for (const double value : series.y) y.include(value);
  }
  x.pad();
  y.pad();
  x.from_px = kLeft, x.to_px = plot.width_px - kRight;
  y.from_px = plot.height_px - kBottom, y.to_px = kTop;
  if (plot.has_equal_scale) equalise(x, y);

  std::string svg = fmt::format(
      "<svg xmlns='http://www.w3.org/2000/svg' width='{0}' height='{1}' viewBox='0 0 {0} {1}' "
      "font-family='sans-serif' font-size='12'>\n<rect width='100%' height='100%' fill='white'/>\n",
      plot.width_px, plot.height_px);
  double legend_px = kLeft;
  std::string legend;
  std::set<std::string> labelled;
  for (const PlotSpan& span : plot.spans) {
    const double from = std::clamp(span.from, x.min, x.max), to = std::clamp(span.to, x.min, x.max);
    svg += fmt::format("<rect x='{:.1f}' y='{:.1f}' width='{:.1f}' height='{:.1f}' fill='{}'/>\n",
                       x.px(from), y.to_px, std::max(1.0, x.px(to) - x.px(from)),
                       y.from_px - y.to_px, span.colour);
    if (labelled.insert(span.label).second)
      legend += legend_entry(legend_px, span.colour, span.label);
  }
  svg += ticks(x, y);
  for (const PlotSeries& series : plot.series) {
    svg += path(series, x, y);
    legend += legend_entry(legend_px, series.colour, series.label);
  }
  svg += legend;
  svg += fmt::format(
      "<text x='{}' y='14' font-size='14' font-weight='bold'>{}</text>\n"
      "<text x='{}' y='{}' text-anchor='middle'>{}</text>\n"
      "<text transform='translate(16 {}) rotate(-90)' text-anchor='middle'>{}</text>\n</svg>\n",
      kLeft, escaped(plot.title), plot.width_px / 2, plot.height_px - 12, escaped(plot.x_label),
      plot.height_px / 2, escaped(plot.y_label));
  return svg;
}

}  // namespace holdfast::sim
