// SPDX-License-Identifier: Apache-2.0
#include "registration/pattern_lattice.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include <opencv2/imgproc.hpp>

#include "registration/census.hpp"

namespace holdfast::registration {
namespace {

constexpr int kTilePx = 128, kLagMinPx = 5, kLagMaxPx = 32;
constexpr int kSpectrumPx = kTilePx + kLagMaxPx;  // no lag wraps round
constexpr int kTilesMax = 9;  // on each level of the pyramid, of those with texture
constexpr int kTilesAcross = 8;
constexpr double kTextureMin = 1.5;  // grey levels, 1 sigma without the noise: less is no texture
constexpr double kProminenceMin = 0.15;  // of a peak over the lowest point on the way to it
constexpr double kStretch = 8;  // a tile's step may differ from the image's by its eighth part

/// Correlation of a tile with itself for lags of x in -kLagMaxPx..kLagMaxPx, y in 0..kLagMaxPx;
/// empty where the tile has no texture.
cv::Mat1f autocorrelation(const cv::Mat1b& tile) {
  cv::Mat1f values, local;
  tile.convertTo(values, CV_32F);
  // Shading and what is larger than any step here.
  cv::blur(values, local, {2 * kLagMaxPx + 1, 2 * kLagMaxPx + 1}, {-1, -1}, cv::BORDER_REFLECT);
  values -= local;
  const double sigma = std::sqrt(cv::mean(values.mul(values))[0]);
  // Highlights are few and far above the rest.
  cv::min(values, 3 * sigma, values);
  cv::max(values, -3 * sigma, values);
  cv::Mat1f padded(kSpectrumPx, kSpectrumPx, 0.F), mask(kSpectrumPx, kSpectrumPx, 0.F);
  const cv::Rect part({}, tile.size());
  values.copyTo(padded(part));
  cv::Mat1f spectrum, correlation;
  cv::dft(padded, spectrum, 0, part.height);
  cv::mulSpectrums(spectrum, spectrum, spectrum, 0, true);
  cv::dft(spectrum, correlation, cv::DFT_INVERSE | cv::DFT_SCALE | cv::DFT_REAL_OUTPUT);
  const auto at = [&](int x, int y) {
    const double raw = static_cast<double>(correlation(y, x < 0 ? kSpectrumPx + x : x));
    return raw /
           (static_cast<double>(part.width - std::abs(x)) * static_cast<double>(part.height - y));
  };
  // The sensor's noise stands at lag 0 alone: its neighbours' parabola passes below it.
  const double along_x = (4 * at(1, 0) - at(2, 0)) / 3, along_y = (4 * at(0, 1) - at(0, 2)) / 3;
  const double variance = std::min(at(0, 0), std::max(along_x, along_y));
  if (!(variance > kTextureMin * kTextureMin)) return {};
  cv::Mat1f result(kLagMaxPx + 1, 2 * kLagMaxPx + 1);
  for (int y = 0; y <= kLagMaxPx; ++y)
    for (int x = -kLagMaxPx; x <= kLagMaxPx; ++x)
      result(y, x + kLagMaxPx) = static_cast<float>(at(x, y) / variance);
  return result;
}

/// By the autocorrelation's symmetry, also for y < 0.
float at(const cv::Mat1f& correlation, int x, int y) {
  return y < 0 ? correlation(-y, kLagMaxPx - x) : correlation(y, kLagMaxPx + x);
}

bool is_peak(const cv::Mat1f& correlation, int x, int y) {
  const float here = at(correlation, x, y);
  for (int j = -1; j <= 1; ++j)
    for (int i = -1; i <= 1; ++i)
      if (std::abs(x + i) <= kLagMaxPx && std::abs(y + j) <= kLagMaxPx &&
          at(correlation, x + i, y + j) > here)
        return false;
  float lowest = here;
  const int steps = std::max(std::abs(x), std::abs(y));
  for (int k = 1; k < steps; ++k)
    lowest = std::min(lowest, at(correlation, static_cast<int>(std::lround(1. * x * k / steps)),
                                 static_cast<int>(std::lround(1. * y * k / steps))));
  return here - lowest >= static_cast<float>(kProminenceMin);
}

/// Peaks only, each as wide as the image's relief and perspective may move it from tile to tile.
cv::Mat1f peaks_of(const cv::Mat1f& correlation) {
  cv::Mat1f peaks(correlation.size(), 0.F);
  for (int y = 0; y <= kLagMaxPx; ++y)
    for (int x = -kLagMaxPx; x <= kLagMaxPx; ++x) {
      const double length = std::hypot(x, y);
      if (length < kLagMinPx || length > kLagMaxPx || !is_peak(correlation, x, y)) continue;
      const int reach = std::max(1, static_cast<int>(std::lround(length / kStretch)));
      for (int j = std::max(y - reach, 0); j <= std::min(y + reach, kLagMaxPx); ++j)
        for (int i = std::max(x - reach, -kLagMaxPx); i <= std::min(x + reach, kLagMaxPx); ++i)
          peaks(j, kLagMaxPx + i) = std::max(peaks(j, kLagMaxPx + i), at(correlation, x, y));
    }
  return peaks;
}

/// 1 sigma of what changes within a few pixels, noise included; from every third row.
double contrast_of(const cv::Mat1b& tile) {
  constexpr int kApart = 3;
  double squares = 0;
  int count = 0;
  for (int y = 0; y < tile.rows; y += 3)
    for (int x = 0; x + kApart < tile.cols; x += 2, ++count) {
      const int difference = tile(y, x + kApart) - tile(y, x);
      squares += std::min(difference * difference, 64 * 64);
    }
  return std::sqrt(squares / (2. * std::max(count, 1)));
}

/// Tiles with texture all over the image, overlapping where it is small.
std::vector<cv::Rect> tiles_of(const cv::Mat1b& image) {
  const int side = std::min({kTilePx, image.cols, image.rows});
  const int across = std::clamp(2 * image.cols / side - 1, 1, kTilesAcross),
            down = std::clamp(2 * image.rows / side - 1, 1, kTilesAcross);
  std::vector<cv::Rect> textured;
  for (int j = 0; j < down; ++j)
    for (int i = 0; i < across; ++i) {
      const cv::Rect tile(across == 1 ? 0 : i * (image.cols - side) / (across - 1),
                          down == 1 ? 0 : j * (image.rows - side) / (down - 1), side, side);
      if (contrast_of(image(tile)) > kTextureMin) textured.push_back(tile);
    }
  std::vector<cv::Rect> chosen;
  const std::size_t count = std::min<std::size_t>(textured.size(), kTilesMax);
  for (std::size_t k = 0; k < count; ++k) chosen.push_back(textured[k * textured.size() / count]);
  return chosen;
}

/// The step in the middle of what peaks_of() has widened; `first`: of it, in reading order.
cv::Point2d middle_of_peak(const cv::Mat1f& medians, cv::Point first) {
  constexpr int kWidest = 2 * static_cast<int>(kLagMaxPx / kStretch) + 1;
  const cv::Rect around =
      cv::Rect(first.x - kWidest, first.y, 2 * kWidest, kWidest) & cv::Rect({}, medians.size());
  cv::Point2d sum;
  double count = 0;
  for (int y = around.y; y < around.br().y; ++y)
    for (int x = around.x; x < around.br().x; ++x)
      if (medians(y, x) == medians(first)) {
        sum += cv::Point2d(x - kLagMaxPx, y);
        ++count;
      }
  return sum / count;
}

ImageRepetition repetition_on_level(const cv::Mat1b& image, WorkerPool& pool) {
  const std::vector<cv::Rect> tiles = tiles_of(image);
  std::vector<cv::Mat1f> found(tiles.size());
  pool.run(static_cast<int>(tiles.size()), [&](int i) {
    const auto k = static_cast<std::size_t>(i);
    const cv::Mat1f correlation = autocorrelation(image(tiles[k]));
    if (!correlation.empty()) found[k] = peaks_of(correlation);
  });
  std::erase_if(found, [](const cv::Mat1f& peaks) { return peaks.empty(); });
  ImageRepetition best;
  best.parts = static_cast<int>(found.size());
  if (found.empty()) return best;
  cv::Mat1f medians(found[0].size());
  std::vector<float> shares(found.size());
  for (int y = 0; y < medians.rows; ++y)
    for (int x = 0; x < medians.cols; ++x) {
      for (std::size_t k = 0; k < found.size(); ++k) shares[k] = found[k](y, x);
      const auto middle = shares.begin() + static_cast<std::ptrdiff_t>(shares.size() / 2);
      std::nth_element(shares.begin(), middle, shares.end());
      medians(y, x) = *middle;
    }
  double most = 0;
  cv::Point first;
  cv::minMaxLoc(medians, nullptr, &most, nullptr, &first);
  best.share = std::min(most, 1.0);
  best.step_px = middle_of_peak(medians, first);
  return best;
}

}  // namespace

ImageRepetition repetition_of(const cv::Mat1b& image, WorkerPool& pool) {
  constexpr int kSideMinPx = 4 * kLagMaxPx;  // of the smallest level: four of its largest steps
  constexpr int kLargePx = 2'000'000;  // no dots are so fine there that their pixels are needed
  ImageRepetition best;
  cv::Mat1b level = image;
  double scale = 1;
  if (image.cols * image.rows > kLargePx) {
    cv::Mat1b smaller;
    halve(level, pool, smaller);
    level = smaller;
    scale = 2;
  }
  for (;; scale *= 2) {
    const ImageRepetition here = repetition_on_level(level, pool);
    if (here.share > best.share || best.parts == 0) {
      best = here;
      best.step_px *= scale;
    }
    if (std::min(level.cols, level.rows) < 2 * kSideMinPx) return best;
    cv::Mat1b smaller;
    halve(level, pool, smaller);
    level = smaller;
  }
}

}  // namespace holdfast::registration
