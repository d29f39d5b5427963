// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/lights.hpp"

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

namespace holdfast::sim {

namespace {

/// Uniform in 0..1, the same with every standard library.
double uniform(std::mt19937& random) {
  return (static_cast<double>(random()) + 0.5) / 4294967296.0;
}

}  // namespace

Eigen::Vector2d ProjectorOptics::project(const Eigen::Vector3d& p_head) const {
  const Eigen::Vector3d p = R_head_projector.transpose() * (p_head - p_head_mm);
  const Eigen::Vector2d m = p.head<2>() / p.z();
  return m * (focal_px * (1 + k1 * m.squaredNorm())) + Eigen::Vector2d(cx_px, cy_px);
}

ProjectorOptics make_projector(std::uint32_t seed, double microscope_focus_mm) {
  std::seed_seq sequence{seed, 0x9a7e12U};
  std::mt19937 random{sequence};
  const auto about = [&random](double middle, double spread) {
    return middle + spread * (2 * uniform(random) - 1);
  };
  ProjectorOptics p;
  p.p_head_mm.x() = about(-38, 1);
  p.p_head_mm.y() = about(12, 1);
  p.p_head_mm.z() = about(4, 1);
  Eigen::Vector3d target;
  target.x() = about(0, 1.5);
  target.y() = about(0, 1.5);
  target.z() = microscope_focus_mm;
  const Eigen::Vector3d z = (target - p.p_head_mm).normalized();
  const Eigen::Vector3d x = Eigen::Vector3d::UnitY().cross(z).normalized();
  p.R_head_projector << x, z.cross(x), z;
  p.focus_mm = (target - p.p_head_mm).norm() + about(0, 1);
  p.focal_px = about(1250, 15);
  p.cx_px = about(399.5, 4);
  p.cy_px = about(299.5, 4);
  p.k1 = about(-0.04, 0.02);
  p.aperture_mm = 4;
  p.blur_px = 0.5;
  return p;
}

cv::Mat diffractive_dots(std::uint32_t seed, int count, double size_mm,
                         const ProjectorOptics& projector) {
  constexpr int kScale = 4;
  const int width = kScale * kProjectorWidthPx, height = kScale * kProjectorHeightPx;
  std::seed_seq sequence{seed, 0xd1ff4aU};
  std::mt19937 random{sequence};
  cv::Mat image = cv::Mat::zeros(height, width, CV_8U);
  const double radius = 0.5 * size_mm / projector.focus_mm * projector.focal_px * kScale;
  const double apart = 2.4 * radius;
  const int columns = static_cast<int>(width / apart) + 1;
  std::vector<std::vector<cv::Point2d>> cells(
      static_cast<std::size_t>(columns) *
      static_cast<std::size_t>(static_cast<int>(height / apart) + 1));
  const auto cell_of = [&](double x, double y) {
    return static_cast<int>(y / apart) * columns + static_cast<int>(x / apart);
  };
  const auto is_free = [&](cv::Point2d p) {
    for (int dy = -1; dy <= 1; ++dy)
      for (int dx = -1; dx <= 1; ++dx) {
        const int cell = cell_of(p.x, p.y) + dy * columns + dx;
        if (cell < 0 || cell >= static_cast<int>(cells.size())) continue;
        for (const cv::Point2d& q : cells[static_cast<std::size_t>(cell)])
          if (std::hypot(p.x - q.x, p.y - q.y) < apart) return false;
      }
    return true;
  };
  for (int attempt = 0, placed = 0; attempt < 20 * count && placed < count; ++attempt) {
    cv::Point2d p;
    p.x = uniform(random) * width;
    p.y = uniform(random) * height;
    if (!is_free(p)) continue;
    cells[static_cast<std::size_t>(cell_of(p.x, p.y))].push_back(p);
    ++placed;
    const int reach = static_cast<int>(std::ceil(radius)) + 1;
    for (int y = std::max(0, static_cast<int>(p.y) - reach);
         y < std::min(height, static_cast<int>(p.y) + reach + 1); ++y)
      for (int x = std::max(0, static_cast<int>(p.x) - reach);
           x < std::min(width, static_cast<int>(p.x) + reach + 1); ++x) {
        const double inside = std::clamp(radius - std::hypot(x - p.x, y - p.y) + 0.5, 0.0, 1.0);
        auto& pixel = image.at<std::uint8_t>(y, x);
        pixel = std::max(pixel, static_cast<std::uint8_t>(std::lround(255 * inside)));
      }
  }
  return image;
}

}  // namespace holdfast::sim
