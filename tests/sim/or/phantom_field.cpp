// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/phantom_field.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace holdfast::sim {
namespace {

using Eigen::Vector3f;

Eigen::Vector4f catmull_rom(const Eigen::Vector4f& a, const Eigen::Vector4f& b,
                            const Eigen::Vector4f& c, const Eigen::Vector4f& d, float t) {
  return 0.5F * (2.F * b + t * (c - a) + t * t * (2.F * a - 5.F * b + 4.F * c - d) +
                 t * t * t * (3.F * b - 3.F * c + d - a));
}

}  // namespace

float ellipsoid(const Vector3f& p, const Vector3f& centre, const Vector3f& radii) noexcept {
  const Vector3f q = (p - centre).cwiseQuotient(radii);
  const float k0 = q.norm();
  const float k1 = q.cwiseQuotient(radii).norm();
  return k1 > 0.F ? k0 * (k0 - 1.F) / k1 : -radii.minCoeff();
}

float box(const Vector3f& p, const Vector3f& half_sizes) noexcept {
  const Vector3f q = p.cwiseAbs() - half_sizes;
  return q.cwiseMax(0.F).norm() + std::min(q.maxCoeff(), 0.F);
}

Tube::Tube(const std::vector<Node>& nodes, int pieces) {
  const int last = static_cast<int>(nodes.size()) - 1;
  const auto node = [&](int i) {
    const Node& n = nodes[static_cast<std::size_t>(std::clamp(i, 0, last))];
    return Eigen::Vector4f(n.p.x(), n.p.y(), n.p.z(), n.radius_mm);
  };
  Eigen::Vector4f from = node(0);
  for (int i = 0; i < last; ++i) {
    const std::size_t first = pieces_.size();
    Eigen::AlignedBox3f span;
    for (int j = 1; j <= pieces; ++j) {
      const float t = static_cast<float>(j) / static_cast<float>(pieces);
      const Eigen::Vector4f to = catmull_rom(node(i - 1), node(i), node(i + 1), node(i + 2), t);
      const Vector3f along = (to - from).head<3>();
      pieces_.push_back(
          {from.head<3>(), along, 1.F / along.squaredNorm(), from.w(), to.w() - from.w()});
      for (const Eigen::Vector4f& end : {from, to}) {
        span.extend(Vector3f(end.head<3>().array() - end.w()));
        span.extend(Vector3f(end.head<3>().array() + end.w()));
      }
      from = to;
    }
    spans_.push_back({span.center(), span.diagonal().norm() / 2.F, first, pieces_.size()});
    bounds_.extend(span);
  }
}

float Tube::distance(const Vector3f& p) const noexcept {
  return distance_within(p, std::numeric_limits<float>::max());
}

float Tube::distance_within(const Vector3f& p, float far) const noexcept {
  const float bound = bounds_.exteriorDistance(p);
  if (bound > far) return bound;
  float nearest = std::numeric_limits<float>::max();
  for (const Span& span : spans_) {
    if ((p - span.centre).norm() - span.reach > nearest) continue;
    for (std::size_t i = span.first; i < span.end; ++i) {
      const Piece& piece = pieces_[i];
      const Vector3f from_start = p - piece.start;
      const float t = std::clamp(from_start.dot(piece.along) * piece.inverse_length2, 0.F, 1.F);
      nearest = std::min(
          nearest, (from_start - t * piece.along).norm() - piece.radius - t * piece.radius_change);
    }
  }
  return nearest;
}

}  // namespace holdfast::sim
