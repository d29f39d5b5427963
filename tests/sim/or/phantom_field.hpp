// SPDX-License-Identifier: Apache-2.0
// Building blocks of implicit shapes: functions of position that are negative inside, zero on the
// surface and grow outside at most as fast as the distance (mm). Pure; any thread.
#pragma once

#include <vector>

#include <Eigen/Geometry>

namespace holdfast::sim {

/// The union of two shapes with the seam filled over a width of `blend_mm`.
[[nodiscard]] inline float blend_union(float a, float b, float blend_mm) noexcept {
  const float h = std::max(blend_mm - std::abs(a - b), 0.F);
  return std::min(a, b) - h * h / (4.F * blend_mm);
}

/// `a` without `b`, the edge rounded over a width of `blend_mm`.
[[nodiscard]] inline float blend_difference(float a, float b, float blend_mm) noexcept {
  return -blend_union(-a, b, blend_mm);
}

/// An ellipsoid's distance, of first order near its surface.
[[nodiscard]] float ellipsoid(const Eigen::Vector3f& p, const Eigen::Vector3f& centre,
                              const Eigen::Vector3f& radii) noexcept;

/// A box about the origin; exact.
[[nodiscard]] float box(const Eigen::Vector3f& p, const Eigen::Vector3f& half_sizes) noexcept;

/// A round tube of varying thickness along a smooth curve through its nodes.
class Tube {
 public:
  struct Node {
    Eigen::Vector3f p;
    float radius_mm;
  };
  /// At least two nodes; a Catmull-Rom curve through them, in `pieces` straight pieces a span.
  explicit Tube(const std::vector<Node>& nodes, int pieces = 6);

  [[nodiscard]] float distance(const Eigen::Vector3f& p) const noexcept;
  /// As distance(), but any value above `far` may be returned where the tube is farther than that.
  [[nodiscard]] float distance_within(const Eigen::Vector3f& p, float far) const noexcept;

 private:
  struct Piece {
    Eigen::Vector3f start, along;
    float inverse_length2, radius, radius_change;
  };
  struct Span {
    Eigen::Vector3f centre;
    float reach;  // of a ball about the centre that holds the span
    std::size_t first, end;
  };
  std::vector<Piece> pieces_;
  std::vector<Span> spans_;
  Eigen::AlignedBox3f bounds_;  // of the whole tube
};

}  // namespace holdfast::sim
