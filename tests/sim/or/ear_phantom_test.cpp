// SPDX-License-Identifier: Apache-2.0
#include <algorithm>

#include <gtest/gtest.h>

#include "tests/sim/or/ear_phantom_shape.hpp"
#include "tests/sim/or/phantom_mesh.hpp"

namespace holdfast::sim {
namespace {

using Eigen::Vector3f;

int crossings_along_view(const EarShape& ear, const Vector3f& p) {
  int crossings = 0;
  bool was_inside = false;
  for (float z = EarShape::bounds().max().z(); z > EarShape::bounds().min().z(); z -= 0.05F) {
    const bool is_inside = ear.distance({p.x(), p.y(), z}) < 0.F;
    crossings += is_inside != was_inside ? 1 : 0;
    was_inside = is_inside;
  }
  return crossings;
}

TEST(EarShape, CurlsOverItsGroove) {
  for (const std::uint32_t seed : {1U, 2U, 1000U}) {
    const EarShape ear(seed);
    ASSERT_GT(ear.overhang().size(), 20U);
    const auto hidden =
        std::count_if(ear.overhang().begin(), ear.overhang().end(),
                      [&ear](const Vector3f& p) { return crossings_along_view(ear, p) >= 3; });
    EXPECT_GT(hidden, static_cast<std::ptrdiff_t>(ear.overhang().size() / 2)) << "seed " << seed;
  }
}

TEST(EarShape, IsAboutNinetyByForty) {
  const EarShape ear(1);
  Eigen::AlignedBox3f extent;
  const Eigen::AlignedBox3f bounds = EarShape::bounds();
  for (float x = bounds.min().x(); x < bounds.max().x(); x += 0.5F)
    for (float y = bounds.min().y(); y < bounds.max().y(); y += 0.5F)
      for (float z = 4.F; z < bounds.max().z(); z += 1.F)
        if (ear.distance({x, y, z}) < 0.F) extent.extend(Vector3f(x, y, z));
  EXPECT_NEAR(extent.sizes().y(), 89.F, 5.F);
  EXPECT_NEAR(extent.sizes().x(), 42.F, 5.F);
  EXPECT_TRUE(bounds.contains(Vector3f(extent.max() + Vector3f::Constant(1.F))));
}

TEST(EarShape, FollowsItsSeed) {
  const EarShape one(1), again(1), other(2);
  const Vector3f p{5.F, 20.F, 12.F};
  EXPECT_EQ(one.distance(p), again.distance(p));
  EXPECT_NE(one.distance(p), other.distance(p));
}

TEST(Polygonise, PutsVerticesOnTheShapeWithNormalsOutwards) {
  const EarShape ear(1);
  const ScalarField field = [&ear](const Vector3f& p) { return ear.distance(p); };
  const LitSurface surface =
      polygonise(field, {Vector3f(4, 20, 4), Vector3f(24, 44, 26)}, 0.5F, true);
  ASSERT_GT(surface.vertices_mm.size(), 2000U);
  std::size_t off = 0, inwards = 0;
  for (std::size_t i = 0; i < surface.vertices_mm.size(); ++i) {
    const Vector3f& p = surface.vertices_mm[i];
    off += std::abs(field(p)) > 0.002F ? 1U : 0U;
    inwards += field(p + 0.05F * surface.normals[i]) < 0.F ? 1U : 0U;
  }
  EXPECT_LT(static_cast<double>(off), 0.005 * static_cast<double>(surface.vertices_mm.size()));
  EXPECT_LT(static_cast<double>(inwards), 0.005 * static_cast<double>(surface.vertices_mm.size()));
  std::size_t turned = 0;
  for (const auto& [a, b, c] : surface.triangles) {
    const auto& v = surface.vertices_mm;
    turned += (v[b] - v[a]).cross(v[c] - v[a]).dot(surface.normals[a]) < 0.F ? 1U : 0U;
  }
  EXPECT_LT(static_cast<double>(turned), 0.01 * static_cast<double>(surface.triangles.size()));
}

TEST(Polygonise, IsClosedAndSkipsNothing) {
  const ScalarField ball = [](const Vector3f& p) { return p.norm() - 3.F; };
  const Eigen::AlignedBox3f box(Vector3f::Constant(-4.F), Vector3f::Constant(4.F));
  const LitSurface skipping = polygonise(ball, box, 0.3F, true);
  const LitSurface whole = polygonise(ball, box, 0.3F, false);
  EXPECT_EQ(skipping.triangles.size(), whole.triangles.size());
  double volume = 0;
  for (const auto& [a, b, c] : whole.triangles)
    volume += static_cast<double>(
                  whole.vertices_mm[a].dot(whole.vertices_mm[b].cross(whole.vertices_mm[c]))) /
              6;
  EXPECT_NEAR(volume, 113.1, 1.5);  // a hole or a turned triangle would show
}

}  // namespace
}  // namespace holdfast::sim
