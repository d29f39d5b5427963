// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/cavity_phantom_cover.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "tests/sim/or/marker_holder.hpp"
#include "tests/sim/or/phantom_mesh.hpp"
#include "tests/sim/or/phantom_random.hpp"

namespace holdfast::sim {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;
using Eigen::Vector3f;

constexpr float kSkinHalfMm = 1.6F;
constexpr float kHoleX = 17.5F, kHoleY = 14.F;  // half axes of the wound

// Height of the skin's middle: the head's roundness, and a swelling towards the wound.
float skin_height(float x, float y) {
  const float r = std::sqrt(x * x / (kHoleX * kHoleX) + y * y / (kHoleY * kHoleY));
  const float swelling = 1.8F * std::exp(-6.F * (r - 1.F) * (r - 1.F));
  const float round = x * x / 260.F + y * y / (y > 0.F ? 900.F : 130.F);
  return 5.2F - round + swelling;
}

LitSurface make_skin(PhantomRandom& random) {
  const auto seed = static_cast<std::uint32_t>(random.bits());
  const ScalarField skin = [seed](const Vector3f& p) {
    const float folds = 0.9F * smooth_noise(p / 6.F, seed);
    const float through = std::abs(p.z() - skin_height(p.x(), p.y()) - folds) * 0.8F - kSkinHalfMm;
    const float wound = ellipsoid({p.x(), p.y(), 0.F}, Vector3f::Zero(), {kHoleX, kHoleY, 1e3F}) -
                        1.5F * smooth_noise(p / 7.F, seed + 1);
    return blend_difference(through, wound, 2.5F);
  };
  LitSurface surface =
      polygonise(skin, {Vector3f(-58, -48, -32), Vector3f(58, 48, 11)}, 0.3F, true);
  add_relief(surface, fine_relief(25.F, 0.9F, seed + 2));
  surface.look = {.albedo_visible = 0.45F,
                  .albedo_nir = 0.62F,
                  .specular = 0.03F,
                  .roughness = 0.45F,
                  .texture_contrast = 0.1F,
                  .texture_mm = 1.F,
                  .scatter_mm = 1.2F,
                  .print = {}};
  return surface;
}

// A blade in the wound's edge and the arm that leads away from it.
void add_retractor(std::vector<LitSurface>& surfaces, double side, PhantomRandom& random) {
  Isometry3d T_site_blade = Isometry3d::Identity();
  T_site_blade.rotate(Eigen::AngleAxisd(random.uniform(-0.2, 0.2), Vector3d::UnitZ()));
  T_site_blade.translate(
      Vector3d(side * (static_cast<double>(kHoleX) - 1), random.uniform(-2, 2), 4));
  T_site_blade.rotate(Eigen::AngleAxisd(side * random.uniform(0.15, 0.35), Vector3d::UnitY()));
  surfaces.push_back(box_surface(T_site_blade, {0.6, 5, 5}, false));
  Isometry3d T_site_arm = T_site_blade;
  T_site_arm.translate(Vector3d(side * 14, 0, 5));
  surfaces.push_back(box_surface(T_site_arm, {14.5, 3, 0.6}, false));
  for (std::size_t i = surfaces.size() - 2; i < surfaces.size(); ++i)
    surfaces[i].look = {.albedo_visible = 0.25F,
                        .albedo_nir = 0.3F,
                        .specular = 0.6F,
                        .roughness = 0.2F,
                        .texture_contrast = 0.05F,
                        .texture_mm = 0.3F,
                        .scatter_mm = 0.F,
                        .print = {}};
}

Look blood_look() {
  return {.albedo_visible = 0.05F,
          .albedo_nir = 0.35F,
          .specular = 0.035F,
          .roughness = 0.02F,
          .texture_contrast = 0.05F,
          .texture_mm = 2.F,
          .scatter_mm = 0.4F,
          .print = {}};
}

}  // namespace

std::vector<LitSurface> make_cover(std::uint32_t seed) {
  PhantomRandom random(0xc0e40000ULL + seed);
  std::vector<LitSurface> surfaces{make_skin(random)};
  add_retractor(surfaces, -1, random);
  add_retractor(surfaces, 1, random);
  return surfaces;
}

std::vector<LitSurface> make_blood(const DrilledCavity& cavity, std::uint32_t seed) {
  PhantomRandom random(0xb100d000ULL + seed);
  std::vector<LitSurface> surfaces;
  // A disc wider than the antrum: bone hides what would stick out.
  const float level = cavity.floor_mm() + static_cast<float>(random.uniform(1.5, 3));
  const Vector3f middle{cavity.antrum().x(), cavity.antrum().y(), level};
  surfaces.push_back(polygonise(
      [middle](const Vector3f& p) {
        return ellipsoid(p, middle, {6.F, 6.F, 0.3F});
      },
      {middle - Vector3f(7, 7, 1), middle + Vector3f(7, 7, 1)}, 0.15F, false));
  for (int i = 0; i < 7; ++i) {
    const double angle = random.uniform(0, 2 * std::numbers::pi);
    const Vector3f out{static_cast<float>(std::cos(angle)), static_cast<float>(std::sin(angle)),
                       0.F};
    Vector3f p{0.F, 0.F, static_cast<float>(random.uniform(-9, -2))};
    while (cavity.distance(p) < 0.F && p.norm() < 20.F) p += 0.05F * out;
    const auto radius = static_cast<float>(random.uniform(0.8, 1.8));
    const Vector3f flat = Vector3f(radius, radius, radius) - 0.6F * radius * out.cwiseAbs();
    surfaces.push_back(polygonise([p, flat](const Vector3f& q) { return ellipsoid(q, p, flat); },
                                  {p - 2.F * flat, p + 2.F * flat}, 0.15F, false));
  }
  for (LitSurface& surface : surfaces) surface.look = blood_look();
  return surfaces;
}

}  // namespace holdfast::sim
