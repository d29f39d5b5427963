// SPDX-License-Identifier: Apache-2.0
// A small line plot as an SVG text: axes with ticks, a legend, shaded spans. For reports.
#pragma once

#include <string>
#include <vector>

namespace holdfast::sim {

struct PlotSeries {
  std::string label;
  std::string colour;  ///< an SVG colour
  std::vector<double> x;
  std::vector<double> y;  ///< NaN breaks the line
};

struct PlotSpan {  ///< a shaded stretch of the x axis
  double from = 0, to = 0;
  std::string colour;
  std::string label;  ///< the legend shows each label once
};

struct Plot {
  std::string title, x_label, y_label;
  std::vector<PlotSeries> series;
  std::vector<PlotSpan> spans;
  bool has_equal_scale = false;  ///< one unit is as long on x as on y
  int width_px = 900, height_px = 360;
};

[[nodiscard]] std::string to_svg(const Plot& plot);

}  // namespace holdfast::sim
