// SPDX-License-Identifier: Apache-2.0
// A reconstruction as a mesh with what its file says of it, and on the whole grid.
#include <algorithm>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "registration/coverage_map.hpp"
#include "registration/reconstruction.hpp"

namespace holdfast::registration {

cv::Mat1f on_whole_grid(const cv::Mat1f& map, const cv::Rect& region_px, cv::Size image_px,
                        float outside) {
  cv::Mat1f whole(image_px, outside);
  map.copyTo(whole(region_px));
  return whole;
}

TriangleMesh mesh_of(const Reconstruction& reconstruction, const Rectification& geometry,
                     int step) {
  constexpr float kSteepest = 5.7F;  // tan(80 degrees)
  const cv::Mat3f& points = reconstruction.points_mm;
  const int columns = (points.cols + step - 1) / step, rows = (points.rows + step - 1) / step;
  constexpr std::uint32_t kNoVertex = 0xffffffff;
  std::vector<std::uint32_t> above(static_cast<std::size_t>(columns), kNoVertex), now(above);
  TriangleMesh mesh;
  mesh.vertices_mm.reserve(
      reconstruction.points / static_cast<std::size_t>(step) / static_cast<std::size_t>(step) + 1);
  const float edge = static_cast<float>(step) * kSteepest / static_cast<float>(geometry.focal_px());
  const auto add = [&](std::uint32_t a, std::uint32_t b, std::uint32_t c) {
    if (a == kNoVertex || b == kNoVertex || c == kNoVertex) return;
    const auto [least, most] =
        std::minmax({mesh.vertices_mm[a].z(), mesh.vertices_mm[b].z(), mesh.vertices_mm[c].z()});
    if (most - least <= edge * least) mesh.triangles.push_back({a, b, c});
  };
  for (int j = 0; j < rows; ++j, std::swap(above, now))
    for (int i = 0; i < columns; ++i) {
      const cv::Vec3f p = points(j * step, i * step);
      const auto at = static_cast<std::size_t>(i);
      now[at] = kNoVertex;
      if (p[2] == p[2]) {
        now[at] = static_cast<std::uint32_t>(mesh.vertices_mm.size());
        mesh.vertices_mm.emplace_back(p[0], p[1], p[2]);
      }
      if (i == 0 || j == 0) continue;
      add(above[at - 1], now[at - 1], above[at]);  // normals towards the camera
      add(above[at], now[at - 1], now[at]);
    }
  cv::Matx33d R1 = geometry.R1;
  mesh.R_rectified_camera.emplace();
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c) (*mesh.R_rectified_camera)(r, c) = R1(r, c);
  const ReconstructedView view{
      geometry.size_px,       reconstruction.region_px,  geometry.focal_px(),
      geometry.P1(0, 2),      geometry.P1(1, 2),         geometry.P2(0, 2),
      geometry.baseline_mm(), reconstruction.nearest_mm, reconstruction.farthest_mm};
  mesh.comments.push_back(view.comment());
  mesh.comments.push_back(fmt::format("image_repetition {:.3f}", reconstruction.image_repetition));
  if (reconstruction.is_for_comparison)
    mesh.comments.push_back(
        fmt::format("{}: under a lattice it may be a period off", kForComparison));
  return mesh;
}

}  // namespace holdfast::registration
