// SPDX-License-Identifier: Apache-2.0
#include "registration/ct/mesh_cleaning.hpp"

#include <algorithm>
#include <numeric>

namespace holdfast::registration {
namespace {

using Parents = std::vector<std::uint32_t>;  // a union-find forest

Parents every_one_its_own(std::size_t count) {
  Parents parent(count);
  std::iota(parent.begin(), parent.end(), 0U);
  return parent;
}

/// Root of i, halving the path.
std::uint32_t root_of(Parents& parent, std::uint32_t i) {
  while (parent[i] != i) i = parent[i] = parent[parent[i]];
  return i;
}

void drop_vertices_without_triangle(TriangleMesh& mesh) {
  std::vector<std::uint32_t> new_index(mesh.vertices_mm.size());
  for (const auto& t : mesh.triangles)
    for (const std::uint32_t corner : t) new_index[corner] = 1;
  std::uint32_t kept = 0;
  for (std::size_t i = 0; i < new_index.size(); ++i) {
    if (new_index[i] == 0) continue;
    mesh.vertices_mm[kept] = mesh.vertices_mm[i];
    new_index[i] = kept++;
  }
  mesh.vertices_mm.resize(kept);
  for (auto& t : mesh.triangles)
    for (std::uint32_t& corner : t) corner = new_index[corner];
}

template <class Condition>
void drop_triangles(TriangleMesh& mesh, const Condition& is_dropped) {
  auto& t = mesh.triangles;
  t.erase(std::remove_if(t.begin(), t.end(), is_dropped), t.end());
  drop_vertices_without_triangle(mesh);
}

}  // namespace

void collapse_edges(const MeshEdges& edges, TriangleMesh& mesh) {
  if (edges.empty()) return;
  Parents parent = every_one_its_own(mesh.vertices_mm.size());
  for (const auto& [a, b] : edges) parent[root_of(parent, a)] = root_of(parent, b);
  for (const auto& edge : edges)
    for (const std::uint32_t end : edge) parent[end] = root_of(parent, end);
  for (auto& t : mesh.triangles)
    for (std::uint32_t& corner : t) corner = parent[corner];
  drop_triangles(mesh, [](const auto& t) { return t[0] == t[1] || t[1] == t[2] || t[2] == t[0]; });
}

void keep_inside(const Eigen::AlignedBox3f& box_mm, TriangleMesh& mesh) {
  drop_triangles(mesh, [&](const auto& t) {
    return !std::all_of(t.begin(), t.end(),
                        [&](auto corner) { return box_mm.contains(mesh.vertices_mm[corner]); });
  });
}

void keep_largest_piece(TriangleMesh& mesh) {
  if (mesh.triangles.empty()) return;
  Parents parent = every_one_its_own(mesh.vertices_mm.size());
  for (const auto& t : mesh.triangles)
    for (const std::uint32_t other : {t[1], t[2]})
      parent[root_of(parent, other)] = root_of(parent, t[0]);
  std::vector<std::size_t> count(parent.size());
  for (const auto& t : mesh.triangles) ++count[root_of(parent, t[0])];
  const auto largest =
      static_cast<std::uint32_t>(std::max_element(count.begin(), count.end()) - count.begin());
  drop_triangles(mesh, [&](const auto& t) { return root_of(parent, t[0]) != largest; });
}

}  // namespace holdfast::registration
