// SPDX-License-Identifier: Apache-2.0
#include "registration/stereo_checks.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <vector>

#include "registration/census.hpp"

namespace holdfast::registration {
namespace {

constexpr int kSaturated = 250, kBlock = 16;
constexpr double kTextureFactor = 2, kTextureFloor = 1.5;  // times the noise, plus grey levels

bool is_textured(const cv::Mat1b& image, int x0, int y0, double deviation_min) {
  int sum = 0, squares = 0;
  for (int y = y0; y < y0 + kBlock; y += 2)
    for (int x = x0; x < x0 + kBlock; ++x) {
      const int grey = image(y, x);
      sum += grey;
      squares += grey * grey;
    }
  const double n = kBlock * kBlock / 2.0, mean = sum / n;
  return squares / n - mean * mean > deviation_min * deviation_min;
}

double median(std::vector<double>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Row of `right` minus row of `left` around one match; empty where the window says too little.
std::optional<double> row_offset(const cv::Mat1b& left, const cv::Mat1b& right, int x0, int y0,
                                 float offset_px) {
  constexpr int kRadius = 8;
  cv::Matx44d A = cv::Matx44d::zeros();
  cv::Vec4d b(0, 0, 0, 0);
  const int column = static_cast<int>(std::floor(offset_px));
  const double share = static_cast<double>(offset_px) - column;
  for (int y = y0 - kRadius; y <= y0 + kRadius; ++y)
    for (int x = x0 - kRadius; x <= x0 + kRadius; ++x) {
      const auto at = [&](int dx, int dy) {
        const uchar* const p = right[y + dy] + x + column + dx;
        return p[0] + (p[1] - p[0]) * share;
      };
      const double grey = at(0, 0);
      const cv::Vec4d row((at(1, 0) - at(-1, 0)) / 2, (at(0, 1) - at(0, -1)) / 2, 1, grey);
      const double residual = left(y, x) - grey;
      for (int i = 0; i < 4; ++i) {
        for (int j = 0; j < 4; ++j) A(i, j) += row[i] * row[j];
        b[i] += row[i] * residual;
      }
    }
  const double least = 20.0 * (2 * kRadius + 1);  // squared slope over the window
  cv::Vec4d step;
  if (A(1, 1) < least || !cv::solve(A, b, step, cv::DECOMP_CHOLESKY)) return {};
  return std::abs(step[0]) < 2 && std::abs(step[1]) < 4 ? std::optional(step[1]) : std::nullopt;
}

}  // namespace

Exposure exposure_of(const cv::Mat1b& image) {
  std::array<int, 256> histogram{};
  int count = 0, saturated = 0, blocks = 0, textured = 0;
  for (int y = 0; y < image.rows; y += 5)
    for (int x = 0; x < image.cols; x += 5, ++count) ++histogram[image(y, x)];
  for (std::size_t i = kSaturated; i < 256; ++i) saturated += histogram[i];
  Exposure exposure;
  int above = 0;
  for (int grey = 255; grey > 0 && above <= count / 100; --grey) {
    above += histogram[static_cast<std::size_t>(grey)];
    exposure.bright_grey = grey;
  }
  const double least = kTextureFactor * noise_of(image) + kTextureFloor;
  for (int y = 0; y + kBlock <= image.rows; y += 3 * kBlock)
    for (int x = 0; x + kBlock <= image.cols; x += 3 * kBlock, ++blocks)
      if (is_textured(image, x, y, least)) ++textured;
  exposure.saturated_share = count > 0 ? static_cast<double>(saturated) / count : 0;
  exposure.textured_share = blocks > 0 ? static_cast<double>(textured) / blocks : 0;
  return exposure;
}

VerticalDisparity vertical_disparity(const RectifiedPair& pair, const cv::Mat1f& disparity_px,
                                     int largest_px) {
  constexpr int kSteps = 40, kTiles = 4, kBorder = 12, kLeastSamples = 8;
  std::array<std::vector<double>, static_cast<std::size_t>(kTiles * kTiles)> tiles;
  std::vector<double> all;
  const int width = disparity_px.cols, height = disparity_px.rows;
  for (int i = 0; i < kSteps; ++i)
    for (int j = 0; j < kSteps; ++j) {
      const int x = kBorder + (width - 2 * kBorder) * j / kSteps;
      const int y = kBorder + (height - 2 * kBorder) * i / kSteps;
      const float offset = static_cast<float>(largest_px) - disparity_px(y, x);
      if (std::isnan(offset)) continue;
      const float right_x = static_cast<float>(x) + offset;
      if (right_x < kBorder || right_x >= static_cast<float>(pair.right.pixels.cols - kBorder))
        continue;
      const auto dy = row_offset(pair.left.pixels, pair.right.pixels, x, y, offset);
      if (!dy) continue;
      const int tile = kTiles * (i * kTiles / kSteps) + j * kTiles / kSteps;
      tiles[static_cast<std::size_t>(tile)].push_back(*dy);
      all.push_back(*dy);
    }
  VerticalDisparity result;
  result.samples = static_cast<int>(all.size());
  if (all.empty()) return result;
  result.median_px = median(all);
  double squares = 0;
  int counted = 0;
  for (auto& tile : tiles) {
    if (tile.size() < kLeastSamples) continue;
    const double offset = median(tile);
    squares += offset * offset;
    ++counted;
  }
  result.rms_px = counted > 0 ? std::sqrt(squares / counted) : std::abs(result.median_px);
  return result;
}

}  // namespace holdfast::registration
