// SPDX-License-Identifier: Apache-2.0
// What a page is made of: text, pictures, charts.
#include <algorithm>
#include <cmath>
#include <cstdint>

#include <fmt/format.h>

#include "rt/study/study_report.hpp"

namespace holdfast::rt {
namespace {

constexpr double kWidth = 640, kHeight = 300, kLeft = 56, kRight = 150, kTop = 34, kBottom = 40;

/// 1, 2 or 5 times a power of ten, so that at most six of them reach `span`.
double tick_step(double span) {
  const double decade = std::pow(10, std::floor(std::log10(span / 6)));
  for (const double factor : {1.0, 2.0, 5.0})
    if (factor * decade * 6 >= span) return factor * decade;
  return 10 * decade;
}

}  // namespace

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

}  // namespace holdfast::rt
