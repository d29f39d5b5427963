// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>

#include "rt/core/error.hpp"
#include "tests/sim/or/cavity_phantom_cover.hpp"
#include "tests/sim/or/cavity_phantom_drill.hpp"
#include "tests/sim/or/cavity_phantom_head.hpp"
#include "tests/sim/or/phantom.hpp"
#include "tests/sim/or/phantom_mesh.hpp"
#include "tests/sim/or/phantom_random.hpp"

namespace holdfast::sim {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;
using Eigen::Vector3f;

constexpr float kBoneHu = 226.F;   // the isosurface that the package's own bone surface is
constexpr float kHuPerMm = 900.F;  // about how fast a CT number falls across the bone's surface
constexpr float kAirHu = -1000.F, kCellularBoneHu = 700.F;
constexpr float kEdgeMm = 0.2F;  // over which a drilled edge is softened in the CT
constexpr float kMeshMm = 0.2F;
const Vector3f entry_from{38, -99.5F, 30};  // outside the right mastoid, frame head

// Frame site: x forward, y up, z out of the head; origin where the drill enters the bone.
struct CavityScene {
  HeadCt head;
  DrilledCavity cavity;
  Isometry3d T_head_site;

  [[nodiscard]] Vector3f to_head(const Vector3f& p_site) const {
    return (T_head_site * p_site.cast<double>()).cast<float>();
  }
  /// Negative in what is left of the bone.
  [[nodiscard]] float bone(const Vector3f& p_site) const {
    const float resolved = (kBoneHu - head.hounsfield(to_head(p_site))) / kHuPerMm;
    const float whole = blend_union(resolved, cavity.cellular_bone(p_site), 0.6F);
    return blend_difference(whole, cavity.distance(p_site), 0.3F);
  }
  [[nodiscard]] float hounsfield(const Vector3f& p_head) const {
    const Vector3f p_site = (T_head_site.inverse() * p_head.cast<double>()).cast<float>();
    const float left = std::clamp(0.5F + cavity.distance(p_site) / kEdgeMm, 0.F, 1.F);
    const float cellular = std::clamp(0.5F - cavity.cellular_bone(p_site) / kEdgeMm, 0.F, 1.F);
    const float resolved = head.hounsfield(p_head);
    const float whole = std::max(resolved, resolved + cellular * (kCellularBoneHu - resolved));
    return kAirHu + left * (whole - kAirHu);
  }
};

// The first bone that a ray from outside towards the head's middle meets.
Vector3d find_entry(const HeadCt& head, const Vector3f& from) {
  Vector3f p = from;
  while (p.x() < 110.F && head.hounsfield(p) < kBoneHu) p.x() += 0.05F;
  if (p.x() >= 110.F) throw UnavailableError("head CT: no bone where the mastoid should be");
  return p.cast<double>();
}

std::shared_ptr<const CavityScene> draw_scene(std::uint32_t seed) {
  PhantomRandom random(0xca710000ULL + seed);
  HeadCt head(HeadCt::kDebianPath);
  const Vector3f shift{0.F, static_cast<float>(random.uniform(-1.5, 1.5)),
                       static_cast<float>(random.uniform(-1.5, 1.5))};
  Eigen::Matrix3d R_side;  // columns: forward, up, out of the right side
  R_side << 0, 0, -1, -1, 0, 0, 0, 1, 0;
  Isometry3d T_head_site = Isometry3d::Identity();
  T_head_site.translate(find_entry(head, entry_from + shift));
  T_head_site.rotate(R_side);
  for (int axis = 0; axis < 3; ++axis)
    T_head_site.rotate(
        Eigen::AngleAxisd(random.uniform(-5, 5) * std::numbers::pi / 180, Vector3d::Unit(axis)));
  return std::make_shared<const CavityScene>(
      CavityScene{std::move(head), DrilledCavity(seed), T_head_site});
}

Look bone_look(CavityRealism realism, PhantomRandom& random) {
  Look look{.albedo_visible = static_cast<float>(random.uniform(0.6, 0.7)),
            .albedo_nir = static_cast<float>(random.uniform(0.68, 0.78)),
            .specular = 0.03F,
            .roughness = 0.6F,
            .texture_contrast = 0.08F,
            .texture_mm = 0.7F,
            .scatter_mm = 0.3F,
            .print = {}};
  if (realism == CavityRealism::bloody) {
    look.albedo_visible *= 0.55F;
    look.albedo_nir *= 0.85F;
    look.specular = 0.05F;
    look.roughness = 0.1F;
    look.texture_contrast = 0.3F;
    look.texture_mm = 1.2F;
    look.scatter_mm = 0.5F;
  }
  return look;
}

void add_surfaces(Phantom& phantom, const CavityScene& scene, CavityRealism realism,
                  std::uint32_t seed) {
  PhantomRandom random(0xca11f000ULL + seed);
  LitSurface bone = polygonise([&scene](const Vector3f& p) { return scene.bone(p); },
                               {Vector3f(-30, -26, -24), Vector3f(30, 26, 6)}, kMeshMm, false);
  add_relief(bone, fine_relief(static_cast<float>(random.uniform(10, 16)),
                               static_cast<float>(random.uniform(0.7, 1.1)),
                               static_cast<std::uint32_t>(random.bits())));
  bone.look = bone_look(realism, random);
  phantom.surfaces.push_back(std::move(bone));
  if (realism != CavityRealism::bone)
    for (LitSurface& surface : make_cover(seed)) phantom.surfaces.push_back(std::move(surface));
  if (realism == CavityRealism::bloody)
    for (LitSurface& pool : make_blood(scene.cavity, seed))
      phantom.surfaces.push_back(std::move(pool));
  for (LitSurface& surface : phantom.surfaces) transform(surface, scene.T_head_site);
}

}  // namespace

Phantom make_cavity_phantom(std::uint32_t seed, CavityRealism realism, PhantomParts parts) {
  const std::shared_ptr<const CavityScene> scene = draw_scene(seed);
  Phantom phantom;
  phantom.name = "cavity";
  if (parts == PhantomParts::all) add_surfaces(phantom, *scene, realism, seed);
  const auto in_ct = [&scene](const Vector3d& low, const Vector3d& high) {
    return Eigen::AlignedBox3d(low, high).transformed(scene->T_head_site);
  };
  phantom.region_of_interest_mm = in_ct({-11, -9, -15}, {11, 9, -1});
  phantom.scan_box_mm = in_ct({-32, -28, -26}, {32, 28, 12});
  phantom.hounsfield = [scene](const Vector3f& p) { return scene->hounsfield(p); };
  phantom.p_focus_ct_mm = scene->T_head_site * Vector3d(0, 0, -8);
  phantom.n_view_ct = scene->T_head_site.linear().col(2);
  phantom.x_view_ct = scene->T_head_site.linear().col(0);
  return phantom;
}

}  // namespace holdfast::sim
