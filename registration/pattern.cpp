// SPDX-License-Identifier: Apache-2.0
#include "registration/pattern.hpp"

#include <algorithm>
#include <cmath>
#include <random>

#include <fmt/format.h>

namespace holdfast::registration {
namespace {

constexpr int kTaps = 4;  // a rim pixel is sampled 4 x 4 times

/// 0..1, the same on every standard library.
double uniform(std::mt19937_64& random) {
  return static_cast<double>(random() >> 11U) * 0x1.0p-53;
}

}  // namespace

std::optional<std::string> invalid_pattern(const PatternParameters& parameters) {
  const auto outside = [](const char* what, double value, double low,
                          double high) -> std::optional<std::string> {
    if (value >= low && value <= high) return {};
    return fmt::format("{} {}, must be {} to {} px", what, value, low, high);
  };
  if (auto bad = outside("dot size", parameters.dot_px, kDotMinPx, kDotMaxPx)) return bad;
  return outside("dot distance", parameters.distance_px, kDistanceMinPx, kDistanceMaxPx);
}

void draw_dot(cv::Mat& image, cv::Point2d centre_px, double diameter_px, int grey) {
  const double x = centre_px.x, y = centre_px.y;
  const double radius = 0.5 * diameter_px;
  const cv::Rect box =
      cv::Rect{cv::Point{static_cast<int>(std::floor(x - radius)) - 1,
                         static_cast<int>(std::floor(y - radius)) - 1},
               cv::Size{static_cast<int>(diameter_px) + 4, static_cast<int>(diameter_px) + 4}} &
      cv::Rect{0, 0, image.cols, image.rows};
  for (int row = box.y; row < box.y + box.height; ++row)
    for (int column = box.x; column < box.x + box.width; ++column) {
      int inside = 0;
      for (int down = 0; down < kTaps; ++down)
        for (int across = 0; across < kTaps; ++across) {
          const double u = column - 0.5 + (across + 0.5) / kTaps - x;
          const double v = row - 0.5 + (down + 0.5) / kTaps - y;
          inside += u * u + v * v <= radius * radius ? 1 : 0;
        }
      auto& pixel = image.at<std::uint8_t>(row, column);
      pixel = std::max(pixel, static_cast<std::uint8_t>(grey * inside / (kTaps * kTaps)));
    }
}

std::vector<PatternCell> pattern_cells(const PatternParameters& parameters) {
  std::vector<PatternCell> cells;
  std::mt19937_64 random{parameters.seed};
  const double pitch_px = parameters.dot_px + parameters.distance_px;
  for (double cell_y = 0.5 * pitch_px; cell_y < kPatternHeightPx; cell_y += pitch_px)
    for (double cell_x = 0.5 * pitch_px; cell_x < kPatternWidthPx; cell_x += pitch_px) {
      // Drawn for every cell, so that one cell's fate does not move the others'.
      const double chance = uniform(random), u = uniform(random), v = uniform(random);
      PatternCell& cell = cells.emplace_back();
      cell.centre_px = cell.dot_px = {cell_x, cell_y};
      cell.is_lit = parameters.kind == PatternKind::lattice || chance < 0.5;
      if (parameters.kind == PatternKind::aperiodic)
        cell.dot_px += cv::Point2d(u - 0.5, v - 0.5) * parameters.distance_px;
      else if (parameters.kind == PatternKind::random)
        cell.dot_px = {u * kPatternWidthPx, v * kPatternHeightPx};
    }
  return cells;
}

cv::Mat make_pattern(const PatternParameters& parameters) {
  cv::Mat image = cv::Mat::zeros(kPatternHeightPx, kPatternWidthPx, CV_8UC1);
  for (const PatternCell& cell : pattern_cells(parameters))
    if (cell.is_lit) draw_dot(image, cell.dot_px, parameters.dot_px);
  return image;
}

}  // namespace holdfast::registration
