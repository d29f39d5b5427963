// SPDX-License-Identifier: Apache-2.0
#include "registration/triangle_tree.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace holdfast::registration {
namespace {

constexpr std::uint32_t kLeafMax = 4;
constexpr std::size_t kDepthMax = 64;  // halving 2^32 triangles needs 32

using Eigen::Vector3d;

/// The closest point of a triangle and which feature it lies on: 0..2 edges ab, bc, ca, 3..5
/// corners a, b, c, 6 the inside. (Regions as in Ericson, Real-Time Collision Detection, 5.1.5.)
std::pair<Vector3d, int> closest_of(const Vector3d& p, const Vector3d& a, const Vector3d& b,
                                    const Vector3d& c) {
  const Vector3d ab = b - a, ac = c - a, ap = p - a, bp = p - b, cp = p - c;
  const double d1 = ab.dot(ap), d2 = ac.dot(ap);
  if (d1 <= 0 && d2 <= 0) return {a, 3};
  const double d3 = ab.dot(bp), d4 = ac.dot(bp);
  if (d3 >= 0 && d4 <= d3) return {b, 4};
  const double d5 = ab.dot(cp), d6 = ac.dot(cp);
  if (d6 >= 0 && d5 <= d6) return {c, 5};
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return {a + d1 / (d1 - d3) * ab, 0};
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return {a + d2 / (d2 - d6) * ac, 2};
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0)
    return {b + (d4 - d3) / ((d4 - d3) + (d5 - d6)) * (c - b), 1};
  const double sum = va + vb + vc;
  return {a + vb / sum * ab + vc / sum * ac, 6};
}

Eigen::AlignedBox3f box_of(const Vector3d& a, const Vector3d& b, const Vector3d& c) {
  Eigen::AlignedBox3f box{a.cast<float>()};
  box.extend(b.cast<float>());
  box.extend(c.cast<float>());
  return box;
}

}  // namespace

TriangleTree::TriangleTree(const TriangleMesh& mesh) {
  normals_.assign(mesh.triangles.size(), Vector3d::Zero());
  for (std::uint32_t t = 0; t < mesh.triangles.size(); ++t) {
    const auto& [i, j, k] = mesh.triangles[t];
    const Vector3d a = mesh.vertices_mm[i].cast<double>(), b = mesh.vertices_mm[j].cast<double>(),
                   c = mesh.vertices_mm[k].cast<double>();
    const Vector3d area = (b - a).cross(c - a);
    if (!(area.norm() > 0)) continue;
    normals_[t] = area.normalized();
    leaves_.push_back({a, b, c, t, 0});
  }
  if (leaves_.empty()) return;
  mark_rim(mesh);
  nodes_.reserve(2 * leaves_.size());
  nodes_.emplace_back();
  build(0, 0, static_cast<std::uint32_t>(leaves_.size()));
}

void TriangleTree::mark_rim(const TriangleMesh& mesh) {
  // An edge that only one triangle has is rim, and so are its corners.
  std::vector<std::pair<std::uint64_t, std::uint32_t>> edges;  // corners, leaf * 3 + edge
  edges.reserve(3 * leaves_.size());
  for (std::uint32_t l = 0; l < leaves_.size(); ++l) {
    const auto& corners = mesh.triangles[leaves_[l].triangle];
    for (std::uint32_t e = 0; e < 3; ++e) {
      const auto [low, high] = std::minmax(corners[e], corners[(e + 1) % 3]);
      edges.emplace_back((std::uint64_t{low} << 32U) | high, l * 3 + e);
    }
  }
  std::sort(edges.begin(), edges.end());
  std::vector<bool> is_rim(mesh.vertices_mm.size(), false);
  for (std::size_t i = 0; i < edges.size(); ++i) {
    if ((i > 0 && edges[i - 1].first == edges[i].first) ||
        (i + 1 < edges.size() && edges[i + 1].first == edges[i].first))
      continue;
    leaves_[edges[i].second / 3].rim |= static_cast<std::uint8_t>(1U << (edges[i].second % 3));
    is_rim[edges[i].first >> 32U] = is_rim[edges[i].first & 0xFFFFFFFFU] = true;
  }
  for (Leaf& leaf : leaves_)
    for (std::uint32_t corner = 0; corner < 3; ++corner)
      if (is_rim[mesh.triangles[leaf.triangle][corner]])
        leaf.rim |= static_cast<std::uint8_t>(8U << corner);
}

void TriangleTree::build(std::uint32_t node, std::uint32_t first, std::uint32_t count) {
  Eigen::AlignedBox3f box;
  Eigen::AlignedBox3d centres;
  for (std::uint32_t i = first; i < first + count; ++i) {
    box.extend(box_of(leaves_[i].a, leaves_[i].b, leaves_[i].c));
    centres.extend((leaves_[i].a + leaves_[i].b + leaves_[i].c) / 3);
  }
  nodes_[node].box = box;
  if (count <= kLeafMax) {
    nodes_[node].first = first;
    nodes_[node].count = count;
    return;
  }
  Eigen::Index axis = 0;
  centres.sizes().maxCoeff(&axis);
  const auto begin = leaves_.begin() + first;
  std::nth_element(begin, begin + count / 2, begin + count, [axis](const Leaf& l, const Leaf& r) {
    return l.a(axis) + l.b(axis) + l.c(axis) < r.a(axis) + r.b(axis) + r.c(axis);
  });
  const auto children = static_cast<std::uint32_t>(nodes_.size());
  nodes_[node].first = children;
  nodes_[node].count = 0;
  nodes_.resize(nodes_.size() + 2);
  build(children, first, count / 2);
  build(children + 1, first + count / 2, count - count / 2);
}

ClosestPoint TriangleTree::closest(const Vector3d& p_mm, double within_mm) const noexcept {
  ClosestPoint best;
  if (nodes_.empty() || !p_mm.allFinite()) return best;
  double best_squared = within_mm * within_mm;
  // The boxes are floats: a little is allowed for what rounding took.
  const Eigen::Vector3f p = p_mm.cast<float>();
  const float slack = 1e-6F * (1 + p.cwiseAbs().maxCoeff());
  std::array<std::uint32_t, kDepthMax> stack;  // NOLINT: written before it is read
  std::size_t depth = 0;
  stack[depth++] = 0;
  while (depth > 0) {
    const Node& node = nodes_[stack[--depth]];
    const double reach = static_cast<double>(std::max(0.F, node.box.exteriorDistance(p) - slack));
    if (reach * reach > best_squared) continue;
    if (node.count == 0) {
      const bool is_left_nearer = nodes_[node.first].box.squaredExteriorDistance(p) <
                                  nodes_[node.first + 1].box.squaredExteriorDistance(p);
      stack[depth++] = node.first + (is_left_nearer ? 1 : 0);
      stack[depth++] = node.first + (is_left_nearer ? 0 : 1);
      continue;
    }
    for (std::uint32_t i = node.first; i < node.first + node.count; ++i) {
      const Leaf& leaf = leaves_[i];
      const auto [q, feature] = closest_of(p_mm, leaf.a, leaf.b, leaf.c);
      const double squared = (q - p_mm).squaredNorm();
      if (squared > best_squared || (best.is_found && squared == best_squared)) continue;
      best_squared = squared;
      best.is_found = true;
      best.p_mm = q;
      best.triangle = leaf.triangle;
      best.is_on_rim = feature < 6 && ((leaf.rim >> static_cast<unsigned>(feature)) & 1U) != 0;
    }
  }
  if (best.is_found) best.distance_mm = std::sqrt(best_squared);
  return best;
}

}  // namespace holdfast::registration
