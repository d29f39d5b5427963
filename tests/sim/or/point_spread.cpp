// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/point_spread.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include <tbb/parallel_for.h>

#include "tests/sim/or/kernel/kernel.hpp"

namespace holdfast::sim {
namespace {

// Weights of -radius..radius whose sum is 1 and whose variance is exactly sigma^2: a sampled
// Gaussian that is narrow has neither.
std::vector<float> gaussian(double sigma) {
  const int radius = std::max(1, static_cast<int>(std::ceil(3.2 * sigma)));
  std::vector<double> w(static_cast<std::size_t>(2 * radius + 1));
  double sum = 0, second = 0;
  for (int k = -radius; k <= radius; ++k) {
    const double value = std::erf((k + 0.5) / (sigma * std::sqrt(2.0))) -
                         std::erf((k - 0.5) / (sigma * std::sqrt(2.0)));
    w[static_cast<std::size_t>(k + radius)] = value;
    sum += value;
    second += value * k * k;
  }
  std::vector<float> weights;
  const double excess = second / sum - sigma * sigma;  // 1/12 of the pixel, less the cut-off tail
  const auto middle = static_cast<std::size_t>(radius);
  for (double& value : w) value /= sum;
  const double moved = 0.5 * std::min(excess, 2 * w[middle + 1]);
  w[middle - 1] -= moved;
  w[middle + 1] -= moved;
  w[middle] += 2 * moved;
  for (const double value : w) weights.push_back(static_cast<float>(value));
  return weights;
}

constexpr int kBand = 32;

}  // namespace

void gaussian_blur(const cv::Mat_<float>& in, double sigma_px, cv::Mat_<float>& out) {
  const std::vector<float> weights = gaussian(sigma_px);
  const int radius = static_cast<int>(weights.size()) / 2, n = in.cols;
  const cv::Mat_<float> source = in.data == out.data ? in.clone() : in;
  out.create(in.size());
  const kernel::Kernel& k = kernel::best_kernel();
  tbb::parallel_for(0, (in.rows + kBand - 1) / kBand, [&](int band) {
    std::vector<const float*> rows(weights.size());
    std::vector<float> padded(static_cast<std::size_t>(n) + 2 * static_cast<std::size_t>(radius));
    for (int y = band * kBand; y < std::min(in.rows, (band + 1) * kBand); ++y) {
      for (int i = -radius; i <= radius; ++i)
        rows[static_cast<std::size_t>(i + radius)] = source[std::clamp(y + i, 0, in.rows - 1)];
      float* middle = padded.data() + radius;
      k.filter_rows(rows.data(), weights.data(), radius, n, middle);
      std::fill(padded.data(), middle, middle[0]);
      std::fill(middle + n, middle + n + radius, middle[n - 1]);
      k.filter_row(middle, weights.data(), radius, n, out[y]);
    }
  });
}

void spread(cv::Mat_<float>& light, const cv::Mat_<float>& variance, double variance_min,
            double variance_max, PointSpreadScratch& scratch) {
  constexpr double kGrowth = 2.5;
  constexpr int kStages = 6;
  double levels[kStages] = {std::max(0.05, variance_min)};
  gaussian_blur(light, std::sqrt(levels[0]), scratch.stages[0]);
  int count = 1;
  while (count < kStages && levels[count - 1] < variance_max) {
    levels[count] = levels[count - 1] * kGrowth;
    gaussian_blur(scratch.stages[count - 1], std::sqrt(levels[count] - levels[count - 1]),
                  scratch.stages[count]);
    ++count;
  }
  tbb::parallel_for(0, light.rows, [&](int y) {
    const float* wanted = variance[y];
    float* out = light[y];
    std::copy_n(scratch.stages[0][y], light.cols, out);
    for (int i = 1; i < count; ++i) {
      const float* low = scratch.stages[i - 1][y];
      const float* high = scratch.stages[i][y];
      const auto from = static_cast<float>(levels[i - 1]);
      const auto per = static_cast<float>(1 / (levels[i] - levels[i - 1]));
      for (int x = 0; x < light.cols; ++x) {
        const float t = std::clamp((wanted[x] - from) * per, 0.F, 1.F);
        // Each stage's step is counted as far as the wanted variance goes into it.
        out[x] += t * (high[x] - low[x]);
      }
    }
  });
}

}  // namespace holdfast::sim
