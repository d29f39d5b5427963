// SPDX-License-Identifier: Apache-2.0
#include "registration/depth_raster.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace holdfast::registration {
namespace {

constexpr double kNearestMm = 1;

/// One triangle in cells, with the inverse of its depths, which is linear in the image.
struct Flat {
  std::array<Eigen::Vector2d, 3> at;
  std::array<double, 3> inverse;
};

double cross(const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
  return a.x() * b.y() - a.y() * b.x();
}

void draw(const Flat& t, cv::Mat1f& depth) {
  const auto [a, b, c] = t.at;
  const double area = cross(b - a, c - a);
  if (!(std::abs(area) > 1e-12)) return;
  const auto first = [](double least) { return std::max(0, static_cast<int>(std::ceil(least))); };
  const auto last = [](double most, int size) {
    return static_cast<int>(std::min(std::floor(most), size - 1.0));
  };
  const int x0 = first(std::min({a.x(), b.x(), c.x()})),
            y0 = first(std::min({a.y(), b.y(), c.y()}));
  const int x1 = last(std::max({a.x(), b.x(), c.x()}), depth.cols),
            y1 = last(std::max({a.y(), b.y(), c.y()}), depth.rows);
  for (int y = y0; y <= y1; ++y)
    for (int x = x0; x <= x1; ++x) {
      const Eigen::Vector2d p(x, y);
      const double of_a = cross(b - p, c - p) / area, of_b = cross(c - p, a - p) / area,
                   of_c = 1 - of_a - of_b;
      if (of_a < 0 || of_b < 0 || of_c < 0) continue;
      const auto z =
          static_cast<float>(1 / (of_a * t.inverse[0] + of_b * t.inverse[1] + of_c * t.inverse[2]));
      float& here = depth(y, x);
      if (!(here <= z)) here = z;
    }
}

}  // namespace

Eigen::Vector2d RasterCamera::cell_of(const Eigen::Vector3d& p_mm) const {
  const double x = focal_px * (p_mm.x() - centre_x_mm) / p_mm.z() + cx_px;
  const double y = focal_px * p_mm.y() / p_mm.z() + cy_px;
  return {(x + 0.5) / cell_px - 0.5, (y + 0.5) / cell_px - 0.5};
}

cv::Mat1f raster_depth(const std::vector<Eigen::Vector3d>& vertices_mm,
                       const std::vector<std::array<std::uint32_t, 3>>& triangles,
                       const RasterCamera& camera) {
  cv::Mat1f depth((camera.size_px.height + camera.cell_px - 1) / camera.cell_px,
                  (camera.size_px.width + camera.cell_px - 1) / camera.cell_px,
                  std::numeric_limits<float>::quiet_NaN());
  for (const auto& corners : triangles) {
    Flat t;
    bool is_in_front = true;
    for (std::size_t k = 0; k < 3; ++k) {
      const Eigen::Vector3d& p = vertices_mm[corners.at(k)];
      is_in_front = is_in_front && p.z() > kNearestMm;
      t.at.at(k) = camera.cell_of(p);
      t.inverse.at(k) = 1 / p.z();
    }
    if (is_in_front) draw(t, depth);
  }
  return depth;
}

}  // namespace holdfast::registration
