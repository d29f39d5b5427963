// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/scatter.hpp"

#include <algorithm>
#include <map>
#include <random>

#include <opencv2/imgproc.hpp>

#include "tests/sim/or/point_spread.hpp"

namespace holdfast::sim {
namespace {

// exp(-r/s) over the plane as two Gaussians of the same volume and nearly the same profile.
constexpr double kNarrow = 0.9, kWide = 2.1, kNarrowShare = 0.4;

// A wide blur needs no fine grid.
cv::Mat_<float> wide_blur(const cv::Mat_<float>& in, double sigma_px) {
  cv::Mat_<float> out;
  const int factor = sigma_px > 12 ? 4 : sigma_px > 6 ? 2 : 1;
  if (factor == 1) {
    gaussian_blur(in, std::max(0.3, sigma_px), out);
    return out;
  }
  cv::Mat_<float> small;
  const cv::Size size((in.cols + factor - 1) / factor, (in.rows + factor - 1) / factor);
  cv::resize(in, small, size, 0, 0, cv::INTER_AREA);
  gaussian_blur(small, sigma_px / factor, small);
  cv::resize(small, out, in.size(), 0, 0, cv::INTER_LINEAR);
  return out;
}

}  // namespace

void scatter_light(const std::vector<LitSurface>& surfaces, const RoomShot& shot, double px_per_mm,
                   const cv::Mat_<std::int16_t>& surface, cv::Mat_<float>& irradiance) {
  std::map<double, std::vector<bool>> by_radius;
  for (std::size_t i = 0; i < surfaces.size(); ++i) {
    const double radius = shot.lights.scatter_mm >= 0
                              ? shot.lights.scatter_mm
                              : static_cast<double>(surfaces[i].look.scatter_mm);
    if (!(radius > 0)) continue;
    auto& has_it = by_radius[radius];
    has_it.resize(surfaces.size(), false);
    has_it[i] = true;
  }
  for (const auto& [radius_mm, has_it] : by_radius) {
    cv::Mat_<float> mask(surface.size()), light(surface.size());
    for (int y = 0; y < surface.rows; ++y)
      for (int x = 0; x < surface.cols; ++x) {
        const int i = surface(y, x);
        const bool is_in = i >= 0 && has_it[static_cast<std::size_t>(i)];
        mask(y, x) = is_in ? 1.F : 0.F;
        light(y, x) = is_in ? irradiance(y, x) : 0.F;
      }
    const double narrow = kNarrow * radius_mm * px_per_mm, wide = kWide * radius_mm * px_per_mm;
    const cv::Mat_<float> light_narrow = wide_blur(light, narrow),
                          light_wide = wide_blur(light, wide);
    const cv::Mat_<float> mask_narrow = wide_blur(mask, narrow), mask_wide = wide_blur(mask, wide);
    const auto share = static_cast<float>(kNarrowShare);
    for (int y = 0; y < surface.rows; ++y)
      for (int x = 0; x < surface.cols; ++x) {
        if (mask(y, x) == 0) continue;
        const float total = share * mask_narrow(y, x) + (1 - share) * mask_wide(y, x);
        irradiance(y, x) =
            (share * light_narrow(y, x) + (1 - share) * light_wide(y, x)) / std::max(total, 1e-3F);
      }
  }
}

void Speckle::apply(cv::Mat_<float>& irradiance, double contrast, cv::Point origin, bool is_right) {
  cv::Mat_<float>& field = fields_[is_right ? 1 : 0];
  if (field.empty()) {
    std::mt19937 random{is_right ? 71U : 37U};
    cv::Mat_<float> parts[2];
    for (cv::Mat_<float>& part : parts) {
      part.create(kSize, kSize);
      for (float& value : part) {
        double sum = 0;  // close to normal
        for (int i = 0; i < 4; ++i) sum += static_cast<double>(random()) / 4294967296.0 - 0.5;
        value = static_cast<float>(sum);
      }
      gaussian_blur(part, 0.9, part);
    }
    field = parts[0].mul(parts[0]) + parts[1].mul(parts[1]);
    field = field * (1 / cv::mean(field)[0]);
  }
  const auto c = static_cast<float>(contrast);
  for (int y = 0; y < irradiance.rows; ++y) {
    const float* row = field[(y + origin.y) % kSize];
    for (int x = 0; x < irradiance.cols; ++x)
      irradiance(y, x) *= 1 + c * (row[(x + origin.x) % kSize] - 1);
  }
}

}  // namespace holdfast::sim
