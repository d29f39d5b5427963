// SPDX-License-Identifier: Apache-2.0
#include "perception/stillness_check.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <utility>

#include <opencv2/imgproc.hpp>

#include "perception/tracker_rules.hpp"

namespace holdfast::perception {
namespace {

constexpr int kBlock = 16;  // pixels of the quarter image
constexpr int kCells = 4;   // per side of the image
constexpr double kStillPx = 0.5;
constexpr double kNoiseSigmas = 3;
constexpr double kNoiseGreyMax = 4;  // what is said to be more is not noise
constexpr double kRounding = 0.5;    // variance of the difference of two rounded levels, and some
constexpr double kUnlikeMin = 0.04;  // 1 - zncc^2: half a pixel of motion explains less
constexpr double kChangedOfCell = 0.25;
constexpr int kWindow = 5;          // pixels of the half image
constexpr int kDilation = 3;        // likewise
constexpr float kTextureGrey2 = 9;  // mean square of the gradient, per pixel of the half image
constexpr float kFixedPx2 = 0.5F;   // what seems to have moved by less (squared, half image)

struct Sums {
  double k = 0, c = 0, kk = 0, cc = 0, kc = 0;
};

Sums sums_of(const cv::Mat& key, const cv::Mat& now, int x0, int y0) {
  std::int32_t k = 0, c = 0, kk = 0, cc = 0, kc = 0;
  for (int y = y0; y < y0 + kBlock; ++y) {
    const uchar *a = key.ptr(y) + x0, *b = now.ptr(y) + x0;
    for (int x = 0; x < kBlock; ++x) {
      k += a[x];
      c += b[x];
      kk += a[x] * a[x];
      cc += b[x] * b[x];
      kc += a[x] * b[x];
    }
  }
  constexpr double kCount = kBlock * kBlock;
  return {k / kCount, c / kCount, kk / kCount, cc / kCount, kc / kCount};
}

}  // namespace

StillnessCheck::StillnessCheck(const CameraModel& camera, const Site& site,
                               const HealthParameters& health, const Pyramid& keyframe)
    : f_px_(camera.f_px()),
      share_max_(health.change_share_max),
      spread_max_(health.change_spread_max),
      half_(keyframe.levels[1].clone()),
      quarter_(keyframe.levels[2].clone()) {
  const double z_mm = site.p_centre_mm().z();
  const double right = camera.width_px - 1, bottom = camera.height_px - 1;
  for (const auto& [u, v] :
       {std::pair{0.0, 0.0}, {right, 0.0}, {0.0, bottom}, {right, bottom}, {right / 2, bottom / 2}})
    p_site_mm_.emplace_back((u - camera.cx_px) / camera.fx_px * z_mm,
                            (v - camera.cy_px) / camera.fy_px * z_mm, z_mm);
}

bool StillnessCheck::is_still(const Eigen::Isometry3d& T_camera_site) const {
  return std::all_of(p_site_mm_.begin(), p_site_mm_.end(), [&](const Eigen::Vector3d& p) {
    return f_px_ * (project(T_camera_site * p) - project(p)).norm() <= kStillPx;
  });
}

bool StillnessCheck::contradicts(const Eigen::Isometry3d& T_camera_site, const Pyramid& image,
                                 double noise_grey) const {
  return is_still(T_camera_site) && has_changed(image.levels[2], noise_grey);
}

bool StillnessCheck::has_changed(const cv::Mat& quarter, double noise_grey) const {
  const double noise = std::min(noise_grey, kNoiseGreyMax) / 4;  // means of 4x4 pixels
  const double noise2 = kNoiseSigmas * kNoiseSigmas * (2 * noise * noise + kRounding);
  std::array<int, std::size_t{kCells} * kCells> textured{}, changed{};
  int textured_all = 0, changed_all = 0;
  for (int y = 0; y + kBlock <= quarter_.rows; y += kBlock)
    for (int x = 0; x + kBlock <= quarter_.cols; x += kBlock) {
      const Sums s = sums_of(quarter_, quarter, x, y);
      const double key2 = s.kk - s.k * s.k, now2 = s.cc - s.c * s.c, both = s.kc - s.k * s.c;
      if (std::max(key2, now2) < 2 * noise2) continue;
      const int row = y * kCells / quarter_.rows, column = x * kCells / quarter_.cols;
      const auto cell = static_cast<std::size_t>(row) * kCells + static_cast<std::size_t>(column);
      ++textured[cell];
      ++textured_all;
      // What the keyframe's block explains, at its best brightness and contrast, is taken out.
      const double left2 = key2 > 0 ? now2 - both * both / key2 : now2;
      if (left2 <= std::max(noise2, kUnlikeMin * now2)) continue;
      ++changed[cell];
      ++changed_all;
    }
  int cells = 0, cells_changed = 0;
  for (std::size_t i = 0; i < textured.size(); ++i) {
    if (textured[i] == 0) continue;
    ++cells;
    if (changed[i] >= kChangedOfCell * textured[i]) ++cells_changed;
  }
  return cells > 0 && changed_all >= share_max_ * textured_all &&
         cells_changed >= spread_max_ * cells;
}

/// Of a texture moved by u, small against its grain, the mean square of what changes is half of u^2
/// times that of its gradient: so the two say how far it seems to have moved, whatever its grain.
cv::Mat StillnessCheck::moving_half(const Pyramid& image) const {
  cv::Mat key, gx, gy, change, moved;
  half_.convertTo(key, CV_32F);
  cv::Sobel(key, gx, CV_32F, 1, 0, 1, 0.5);
  cv::Sobel(key, gy, CV_32F, 0, 1, 1, 0.5);
  cv::subtract(image.levels[1], half_, change, cv::noArray(), CV_32F);
  const auto mean = [](const cv::Mat& values) -> cv::Mat {
    cv::Mat out;
    cv::boxFilter(values, out, CV_32F, {kWindow, kWindow}, {-1, -1}, true, cv::BORDER_REFLECT);
    return out;
  };
  const cv::Mat gradient2 = mean(gx.mul(gx) + gy.mul(gy)), change2 = mean(change.mul(change));
  cv::Mat fixed(half_.size(), CV_8UC1);
  for (int y = 0; y < fixed.rows; ++y) {
    const auto *g2 = gradient2.ptr<float>(y), *c2 = change2.ptr<float>(y);
    uchar* out = fixed.ptr(y);
    for (int x = 0; x < fixed.cols; ++x)
      out[x] = g2[x] > kTextureGrey2 && c2[x] < 0.5F * kFixedPx2 * g2[x] ? 255 : 0;
  }
  cv::dilate(fixed, fixed, cv::getStructuringElement(cv::MORPH_ELLIPSE, {kDilation, kDilation}));
  return ~fixed;
}

}  // namespace holdfast::perception
