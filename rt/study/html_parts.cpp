// SPDX-License-Identifier: Apache-2.0
// What a page is made of: text, pictures, charts.
#include <algorithm>
#include <cmath>
#include <cstdint>

#include <fmt/format.h>

#include "rt/study/study_report.hpp"

namespace holdfast::rt {
namespace {

constexpr const char* kStyle =
    "body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;"
    "color:#1b2733}h1{font-size:1.6rem}h2{font-size:1.2rem;margin-top:2.2rem}"
    "table{border-collapse:collapse;margin:1rem 0;font-size:.9rem}th,td{padding:.3rem .7rem;"
    "text-align:right;border-bottom:1px solid #d8dee4}th{background:#f2f5f8}"
    "th:first-child,td:first-child{text-align:left}caption{text-align:left;font-weight:600;"
    "padding:.3rem "
    "0}.q{color:#6b4e00;font-style:italic}.m{color:#a11}.w{background:#fff4d6;border-left:4px "
    "solid #d99b00;padding:.6rem 1rem}figure{display:inline-block;margin:.5rem 1rem .5rem "
    "0;vertical-align:top}figure img{width:26rem;max-width:100%;border:1px solid #ccc}"
    "svg{width:100%;max-width:44rem;height:auto;font:12px system-ui,sans-serif;fill:#1b2733}"
    "svg .t{font-weight:600;font-size:14px}svg .g{stroke:#d8dee4}svg path{fill:none}";

constexpr double kWidth = 640, kHeight = 300, kLeft = 56, kRight = 150, kTop = 34, kBottom = 40;

/// 1, 2 or 5 times a power of ten, so that at most six of them reach `span`.
double tick_step(double span) {
  const double decade = std::pow(10, std::floor(std::log10(span / 6)));
  for (const double factor : {1.0, 2.0, 5.0})
    if (factor * decade * 6 >= span) return factor * decade;
  return 10 * decade;
}

}  // namespace

std::string page_head(const std::string& title) {
  return fmt::format(
      "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" "
      "content=\"width=device-width\"><title>{}</title><style>{}</style></head><body>\n",
      escaped(title), kStyle);
}

std::string escaped(const std::string& text) {
  std::string result;
  for (const char c : text) switch (c) {
      case '&':
        result += "&amp;";
        break;
      case '<':
        result += "&lt;";
        break;
      case '>':
        result += "&gt;";
        break;
      case '"':
        result += "&quot;";
        break;
      default:
        result += c;
    }
  return result;
}

std::string base64(const std::string& bytes) {
  constexpr const char* kDigits =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string result;
  result.reserve(bytes.size() * 4 / 3 + 4);
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    std::uint32_t three = 0;
    for (std::size_t k = 0; k < 3; ++k)
      three = three << 8U | (i + k < bytes.size() ? static_cast<std::uint8_t>(bytes[i + k]) : 0U);
    for (std::size_t k = 0; k < 4; ++k)
      result += k <= bytes.size() - i || bytes.size() - i >= 3
                    ? kDigits[three >> (18U - 6U * static_cast<unsigned>(k)) & 63U]
                    : '=';
  }
  return result;
}

std::string zoom_chart(const std::string& title, const std::vector<double>& zooms,
                       const std::vector<ZoomLine>& lines) {
  double highest = 0;
  for (const ZoomLine& line : lines)
    for (const double y : line.y)
      if (std::isfinite(y)) highest = std::max(highest, y);
  if (!(highest > 0)) highest = 1;
  const double step = tick_step(highest), top = step * std::ceil(highest / step);
  const double first = zooms.front(), span = std::max(zooms.back() - first, 1e-9);
  const auto px = [&](double zoom) {
    return kLeft + (zooms.size() > 1 ? (zoom - first) / span : 0.5) * (kWidth - kLeft - kRight);
  };
  const auto py = [&](double y) {
    return kHeight - kBottom - y / top * (kHeight - kTop - kBottom);
  };
  std::string svg = fmt::format(
      "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {}\" role=\"img\" "
      "aria-label=\"{}\"><text x=\"{}\" y=\"18\" class=\"t\">{}</text>\n",
      kWidth, kHeight, escaped(title), kLeft, escaped(title));
  for (double y = 0; y <= top + 0.5 * step; y += step)
    svg += fmt::format(
        "<line x1=\"{0}\" x2=\"{1}\" y1=\"{2:.1f}\" y2=\"{2:.1f}\" class=\"g\"/>"
        "<text x=\"{3}\" y=\"{4:.1f}\" text-anchor=\"end\">{5:.3g}</text>\n",
        kLeft, kWidth - kRight, py(y), kLeft - 6, py(y) + 4, y);
  for (const double zoom : zooms)
    svg += fmt::format("<text x=\"{:.1f}\" y=\"{}\" text-anchor=\"middle\">{:g}</text>\n", px(zoom),
                       kHeight - kBottom + 18, zoom);
  svg += fmt::format("<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">zoom</text>\n",
                     (kLeft + kWidth - kRight) / 2, kHeight - 6);
  for (std::size_t i = 0; i < lines.size(); ++i) {
    const ZoomLine& line = lines[i];
    std::string path;
    for (std::size_t k = 0; k < zooms.size() && k < line.y.size(); ++k) {
      if (!std::isfinite(line.y[k])) continue;
      path +=
          fmt::format("{}{:.1f} {:.1f}", path.empty() ? "M" : " L", px(zooms[k]), py(line.y[k]));
      svg += fmt::format("<circle cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"3.5\" fill=\"{}\"/>\n",
                         px(zooms[k]), py(line.y[k]), line.colour);
    }
    svg += fmt::format("<path d=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"2\"/>\n", path,
                       line.colour);
    const double at = kTop + 10 + 20 * static_cast<double>(i);
    svg += fmt::format(
        "<circle cx=\"{}\" cy=\"{}\" r=\"4\" fill=\"{}\"/><text x=\"{}\" y=\"{}\">{}</text>\n",
        kWidth - kRight + 16, at, line.colour, kWidth - kRight + 26, at + 4, escaped(line.label));
  }
  return svg + "</svg>\n";
}

std::string plane_chart(const PlaneChart& chart) {
  constexpr double kSide = 360, kMargin = 44;
  double reach = 0;
  for (const PlaneSeries& series : chart.series)
    for (const std::vector<double>* values : {&series.x, &series.y})
      for (const double v : *values)
        if (std::isfinite(v)) reach = std::max(reach, std::abs(v));
  const double step = tick_step(reach > 0 ? 2 * reach : 1);
  const double limit = step * std::ceil(std::max(reach, step) / step);
  const auto px = [&](double v) { return kMargin + (v / limit + 1) / 2 * (kSide - 2 * kMargin); };
  std::string svg = fmt::format(
      "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {0} {0}\" role=\"img\" "
      "style=\"max-width:{0}px\" aria-label=\"{1}\"><text x=\"{2}\" y=\"18\" "
      "class=\"t\">{1}</text>\n",
      kSide, escaped(chart.title), kMargin);
  for (double v = -limit; v <= limit + 0.5 * step; v += step)
    svg += fmt::format(
        "<path class=\"g\" d=\"M{0:.1f} {1} V{2} M{1} {0:.1f} H{2}\"/>"
        "<text x=\"{0:.1f}\" y=\"{3}\" text-anchor=\"middle\">{4:g}</text>"
        "<text x=\"{5}\" y=\"{6:.1f}\" text-anchor=\"end\">{4:g}</text>\n",
        px(v), kMargin, kSide - kMargin, kSide - kMargin + 16, std::abs(v) < 1e-9 ? 0 : v,
        kMargin - 5, px(v) + 4);
  for (const PlaneSeries& series : chart.series) {
    std::string path;
    for (std::size_t i = 0; i < series.x.size() && i < series.y.size(); ++i) {
      if (!std::isfinite(series.x[i] + series.y[i])) continue;
      const double x = px(series.x[i]), y = px(series.y[i]);
      if (chart.is_line)
        path += fmt::format("{}{:.1f} {:.1f}", path.empty() ? "M" : " L", x, y);
      else
        svg += fmt::format("<circle cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"1.8\" fill=\"{}\"/>\n", x, y,
                           series.colour);
    }
    if (!path.empty())
      svg += fmt::format("<path d=\"{}\" stroke=\"{}\" stroke-width=\"{}\"/>\n", path,
                         series.colour, series.width);
  }
  return svg + "</svg>\n";
}

}  // namespace holdfast::rt
