// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/marker_holder.hpp"

#include <opencv2/aruco.hpp>

#include "tests/sim/or/phantom_field.hpp"

namespace holdfast::sim {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3f;

constexpr int kCellPx = 32;  // of the print, a cell of the marker
constexpr float kInk = 0.06F;

cv::Mat_<float> print_marker(int id) {
  cv::Mat_<std::uint8_t> marker;
  cv::aruco::drawMarker(cv::aruco::getPredefinedDictionary(cv::aruco::DICT_4X4_50), id, 6 * kCellPx,
                        marker, 1);
  cv::Mat_<float> print(8 * kCellPx, 8 * kCellPx, 1.F);
  for (int row = 0; row < marker.rows; ++row)
    for (int column = 0; column < marker.cols; ++column)
      if (marker(row, column) == 0) print(row + kCellPx, column + kCellPx) = kInk;
  return print;
}

void add_face(LitSurface& surface, const Eigen::Isometry3d& T_ct_box, const Vector3d& centre,
              const Vector3d& right, const Vector3d& up) {
  const auto first = static_cast<std::uint32_t>(surface.vertices_mm.size());
  for (int i = 0; i < 4; ++i) {
    const double u = (i & 1) != 0 ? 1 : -1;
    const double v = (i & 2) != 0 ? 1 : -1;
    surface.vertices_mm.emplace_back((T_ct_box * (centre + u * right + v * up)).cast<float>());
    surface.normals.emplace_back((T_ct_box.linear() * right.cross(up).normalized()).cast<float>());
  }
  surface.triangles.push_back({first, first + 1, first + 3});
  surface.triangles.push_back({first, first + 3, first + 2});
}

}  // namespace

float holder_distance(const MarkerHolder& holder, const Vector3f& p_ct) {
  Vector3f p =
      (holder.marker.T_ct_marker.inverse(Eigen::Isometry) * p_ct.cast<double>()).cast<float>();
  const auto half_side = static_cast<float>(kHolderSideMm / 2);
  const auto half_length = static_cast<float>(holder.length_mm / 2);
  p.z() += half_length;
  return box(p, {half_side, half_side, half_length});
}

LitSurface marker_surface(const MarkerHolder& holder) {
  LitSurface surface;
  constexpr double kHalf = kHolderSideMm / 2;
  add_face(surface, holder.marker.T_ct_marker, Vector3d::Zero(), kHalf * Vector3d::UnitX(),
           kHalf * Vector3d::UnitY());
  // The print grows and shrinks about its middle; beyond its border all is white.
  const auto half = static_cast<float>(0.5 * kMarkerSideMm / holder.marker.side_mm);
  const float low = 0.5F - half, high = 0.5F + half;
  surface.uv = {{low, high}, {high, high}, {low, low}, {high, low}};
  surface.look = {.albedo_visible = 0.8F,
                  .albedo_nir = 0.75F,
                  .specular = 0.02F,
                  .roughness = 0.7F,
                  .print = print_marker(holder.marker.aruco_id)};
  return surface;
}

LitSurface block_surface(const MarkerHolder& holder, const Look& look) {
  Eigen::Isometry3d T_ct_box = holder.marker.T_ct_marker;
  T_ct_box.translate(Vector3d(0, 0, -holder.length_mm / 2));
  LitSurface surface =
      box_surface(T_ct_box, {kHolderSideMm / 2, kHolderSideMm / 2, holder.length_mm / 2}, true);
  surface.look = look;
  return surface;
}

LitSurface box_surface(const Eigen::Isometry3d& T_ct_box, const Vector3d& half_sizes_mm,
                       bool is_open) {
  LitSurface surface;
  for (int axis = 0; axis < 3; ++axis)
    for (const double side : {1.0, -1.0}) {
      if (is_open && axis == 2 && side > 0) continue;
      const Vector3d out = side * half_sizes_mm[axis] * Vector3d::Unit(axis);
      const Vector3d right = half_sizes_mm[(axis + 1) % 3] * Vector3d::Unit((axis + 1) % 3);
      const Vector3d up = side * half_sizes_mm[(axis + 2) % 3] * Vector3d::Unit((axis + 2) % 3);
      add_face(surface, T_ct_box, out, right, up);
    }
  return surface;
}

}  // namespace holdfast::sim
