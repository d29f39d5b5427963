// SPDX-License-Identifier: Apache-2.0
#include "bridge/surface_depth.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "registration/mesh_file.hpp"
#include "rt/core/error.hpp"

namespace holdfast::bridge {
namespace {

/// Draws one triangle: 1/z is linear over the image.
void draw(const std::array<Eigen::Vector3d, 3>& corners, cv::Mat& depth_mm) {
  const Eigen::Vector2d a = corners[0].head<2>(), b = corners[1].head<2>(),
                        c = corners[2].head<2>();
  const double area = (b - a).x() * (c - a).y() - (b - a).y() * (c - a).x();
  if (!(std::abs(area) > 1e-12)) return;
  const auto low = [](double v, int n) {
    return static_cast<int>(std::clamp(std::ceil(v), 0.0, static_cast<double>(n)));
  };
  const int x0 = low(std::min({a.x(), b.x(), c.x()}), depth_mm.cols);
  const int y0 = low(std::min({a.y(), b.y(), c.y()}), depth_mm.rows);
  const int x1 = low(std::max({a.x(), b.x(), c.x()}) + 1e-9, depth_mm.cols);
  const int y1 = low(std::max({a.y(), b.y(), c.y()}) + 1e-9, depth_mm.rows);
  for (int y = y0; y <= std::min(y1, depth_mm.rows - 1); ++y)
    for (int x = x0; x <= std::min(x1, depth_mm.cols - 1); ++x) {
      const Eigen::Vector2d p(x, y);
      const double wb = ((p - a).x() * (c - a).y() - (p - a).y() * (c - a).x()) / area;
      const double wc = ((b - a).x() * (p - a).y() - (b - a).y() * (p - a).x()) / area;
      const double wa = 1 - wb - wc;
      constexpr double kEdge = -1e-9;  // a pixel on a shared edge belongs to both triangles
      if (wa < kEdge || wb < kEdge || wc < kEdge) continue;
      const double z = 1 / (wa / corners[0].z() + wb / corners[1].z() + wc / corners[2].z());
      auto& pixel = depth_mm.at<float>(y, x);
      if (std::isnan(pixel) || z < static_cast<double>(pixel)) pixel = static_cast<float>(z);
    }
}

}  // namespace

cv::Mat depth_from_surface_file(const std::string& path, const perception::CameraModel& camera) {
  const registration::TriangleMesh mesh = registration::read_mesh(path);
  if (mesh.triangles.empty()) throw InputError(path + ": holds no triangle");
  const Eigen::Matrix3d R_camera_mesh =
      mesh.R_rectified_camera.value_or(Eigen::Matrix3d::Identity()).transpose();
  cv::Mat depth_mm(camera.height_px, camera.width_px, CV_32FC1,
                   cv::Scalar::all(std::numeric_limits<double>::quiet_NaN()));
  for (const auto& triangle : mesh.triangles) {
    std::array<Eigen::Vector3d, 3> corners;
    bool is_in_front = true;
    for (std::size_t k = 0; k < 3; ++k) {
      const Eigen::Vector3d p = R_camera_mesh * mesh.vertices_mm[triangle[k]].cast<double>();
      is_in_front = is_in_front && p.z() > 1e-3;
      corners[k] = {camera.fx_px * p.x() / p.z() + camera.cx_px,
                    camera.fy_px * p.y() / p.z() + camera.cy_px, p.z()};
    }
    if (is_in_front) draw(corners, depth_mm);
  }
  return depth_mm;
}

}  // namespace holdfast::bridge
