// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <memory>
#include <numbers>

#include "tests/sim/or/ear_phantom_shape.hpp"
#include "tests/sim/or/marker_holder.hpp"
#include "tests/sim/or/phantom.hpp"
#include "tests/sim/or/phantom_mesh.hpp"
#include "tests/sim/or/phantom_random.hpp"

namespace holdfast::sim {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;
using Eigen::Vector3f;

constexpr float kAirHu = -1000.F, kMetalHu = 8000.F;
constexpr float kEdgeMm = 0.1F;       // width over which an edge is softened, so that a scanner
                                      // that samples more coarsely than this still sees its place
constexpr float kMeshMm = 0.15F;      // between vertices
constexpr double kPlateTopMm = -3.0;  // z in frame ear
const Vector3d plate_half_mm{40, 49, 3};  // the base plate
const Vector3d plate_centre_mm{1, 0, kPlateTopMm - 3};

double radians(double degrees) {
  return degrees * std::numbers::pi / 180.0;
}

// Everything that CT and light have in common. Shared by copies of the phantom, never changed.
struct EarScene {
  EarShape ear;
  Isometry3d T_ct_ear;
  Isometry3d T_ear_ct;
  std::vector<MarkerHolder> holders;
  float plastic_hu;

  [[nodiscard]] float plastic_distance(const Vector3f& p_ct) const;
  [[nodiscard]] float bead_distance(const Vector3f& p_ct) const;
  [[nodiscard]] float hounsfield(const Vector3f& p_ct) const;
};

float EarScene::plastic_distance(const Vector3f& p_ct) const {
  const Vector3f p = (T_ear_ct * p_ct.cast<double>()).cast<float>();
  float d = box(p - plate_centre_mm.cast<float>(), plate_half_mm.cast<float>());
  const float to_ear = EarShape::bounds().exteriorDistance(p);
  if (to_ear < std::max(d, 1.F)) d = std::min(d, to_ear > 1.F ? to_ear : ear.distance(p));
  for (const MarkerHolder& holder : holders) d = std::min(d, holder_distance(holder, p_ct));
  return d;
}

float EarScene::bead_distance(const Vector3f& p_ct) const {
  float d = std::numeric_limits<float>::max();
  for (const MarkerHolder& holder : holders)
    d = std::min(d, (p_ct - holder.marker.p_bead_ct_mm.cast<float>()).norm());
  return d - static_cast<float>(kBeadDiameterMm / 2);
}

float EarScene::hounsfield(const Vector3f& p_ct) const {
  const auto fill = [](float d) { return std::clamp(0.5F - d / kEdgeMm, 0.F, 1.F); };
  const float metal = fill(bead_distance(p_ct));
  const float base = kAirHu + (plastic_hu - kAirHu) * fill(plastic_distance(p_ct));
  return base + metal * (kMetalHu - base);
}

// The head lies on its back: the ear's z (out of the head) is up, -y of LPS, give or take; y is
// along the table. Nothing is aligned with the scanner, and the origin is nowhere near.
Isometry3d draw_pose(PhantomRandom& random) {
  Eigen::Matrix3d R_lying;
  R_lying << 1, 0, 0, 0, 0, -1, 0, 1, 0;
  Isometry3d T_ct_ear = Isometry3d::Identity();
  T_ct_ear.translate(
      Vector3d(random.uniform(-40, 40), random.uniform(-160, -120), random.uniform(-180, 180)));
  for (int axis = 0; axis < 3; ++axis)
    T_ct_ear.rotate(Eigen::AngleAxisd(radians(random.uniform(-8, 8)), Vector3d::Unit(axis)));
  T_ct_ear.rotate(R_lying);
  return T_ct_ear;
}

// One holder in each corner, all of different height and inclination.
std::vector<MarkerHolder> draw_holders(PhantomRandom& random, PhantomRandom& sides,
                                       const Isometry3d& T_ct_ear) {
  std::array<double, 4> heights{8.0, 11.5, 15.0, 18.5};
  std::array<double, 4> inclinations{5.0, 9.0, 13.0, 17.0};
  for (std::size_t i = 3; i > 0; --i) {
    std::swap(heights[i], heights[random.bits() % (i + 1)]);
    std::swap(inclinations[i], inclinations[random.bits() % (i + 1)]);
  }
  std::vector<MarkerHolder> holders;
  for (int i = 0; i < 4; ++i) {
    const auto n = static_cast<std::size_t>(i);
    const double height = heights[n] + random.uniform(-1, 1);
    const double towards = random.uniform(-std::numbers::pi, std::numbers::pi);
    Isometry3d T_ear_marker = Isometry3d::Identity();
    T_ear_marker.translate(Vector3d((i % 2 == 0 ? -1 : 1) * random.uniform(29.5, 31.5) + 1,
                                    (i < 2 ? 1 : -1) * random.uniform(26, 37),
                                    kPlateTopMm + height));
    T_ear_marker.rotate(Eigen::AngleAxisd(radians(inclinations[n] + random.uniform(-1.5, 1.5)),
                                          Vector3d(std::cos(towards), std::sin(towards), 0)));
    T_ear_marker.rotate(Eigen::AngleAxisd(radians(random.uniform(-25, 25)), Vector3d::UnitZ()));
    MarkerHolder holder;
    holder.marker.aruco_id = i;
    holder.marker.side_mm = kMarkerSideMm + sides.normal(kMarkerSideSigmaMm);
    holder.marker.T_ct_marker = T_ct_ear * T_ear_marker;
    const Vector3d made_off{random.normal(0.01), random.normal(0.01), random.normal(0.02)};
    holder.marker.p_bead_ct_mm =
        holder.marker.T_ct_marker * (Vector3d(0, 0, -kBeadDepthMm) + made_off);
    holder.length_mm = height + 3.5;  // ends inside the plate
    holders.push_back(holder);
  }
  return holders;
}

std::shared_ptr<const EarScene> draw_scene(std::uint32_t seed) {
  PhantomRandom random(0x5ce7e000ULL + seed);
  PhantomRandom sides(0x51de5000ULL + seed);
  const Isometry3d T_ct_ear = draw_pose(random);
  return std::make_shared<const EarScene>(EarScene{EarShape(seed), T_ct_ear, T_ct_ear.inverse(),
                                                   draw_holders(random, sides, T_ct_ear),
                                                   static_cast<float>(random.uniform(110, 190))});
}

Look draw_paint(PhantomRandom& random) {
  Look look;
  look.albedo_visible = static_cast<float>(random.uniform(0.5, 0.65));
  look.albedo_nir = static_cast<float>(random.uniform(0.6, 0.75));
  look.specular = static_cast<float>(random.uniform(0.03, 0.05));
  look.roughness = static_cast<float>(random.uniform(0.3, 0.5));
  look.texture_contrast = static_cast<float>(random.uniform(0.01, 0.05));
  look.texture_mm = static_cast<float>(random.uniform(0.4, 0.9));
  return look;
}

void add_surfaces(Phantom& phantom, const EarScene& scene, std::uint32_t seed) {
  PhantomRandom random(0x9a117000ULL + seed);
  LitSurface ear = polygonise([&scene](const Vector3f& p) { return scene.ear.distance(p); },
                              EarShape::bounds(), kMeshMm, true);
  add_relief(ear, fine_relief(static_cast<float>(random.uniform(8, 14)),
                              static_cast<float>(random.uniform(0.6, 1.0)),
                              static_cast<std::uint32_t>(random.bits())));
  transform(ear, scene.T_ct_ear);
  ear.look = draw_paint(random);
  phantom.surfaces.push_back(std::move(ear));

  const Look matt{.albedo_visible = 0.25F,
                  .albedo_nir = 0.3F,
                  .specular = 0.03F,
                  .roughness = 0.8F,
                  .texture_contrast = 0.02F,
                  .print = {}};
  Isometry3d T_ct_plate = scene.T_ct_ear;
  T_ct_plate.translate(plate_centre_mm);
  phantom.surfaces.push_back(box_surface(T_ct_plate, plate_half_mm, false));
  phantom.surfaces.back().look = matt;
  for (const MarkerHolder& holder : scene.holders) {
    phantom.surfaces.push_back(marker_surface(holder));
    phantom.surfaces.push_back(block_surface(holder, matt));
  }
}

Eigen::AlignedBox3d bounds_in_ct(const Isometry3d& T_ct_ear, const Vector3d& low,
                                 const Vector3d& high) {
  return Eigen::AlignedBox3d(low, high).transformed(T_ct_ear);
}

}  // namespace

Phantom make_ear_phantom(std::uint32_t seed, PhantomParts parts) {
  const std::shared_ptr<const EarScene> scene = draw_scene(seed);
  Phantom phantom;
  phantom.name = "ear";
  if (parts == PhantomParts::all) add_surfaces(phantom, *scene, seed);
  for (const MarkerHolder& holder : scene->holders) phantom.markers.push_back(holder.marker);
  phantom.region_of_interest_mm = bounds_in_ct(scene->T_ct_ear, {-16, -30, 4}, {18, 32, 19});
  phantom.scan_box_mm = bounds_in_ct(scene->T_ct_ear, {-44, -53, -11}, {46, 53, 27});
  phantom.hounsfield = [scene](const Vector3f& p_ct) { return scene->hounsfield(p_ct); };
  phantom.clearance_mm = [scene](const Vector3f& p_ct) {
    const float plastic = std::abs(scene->plastic_distance(p_ct)) / 1.5F;
    return std::min(plastic, std::abs(scene->bead_distance(p_ct))) - kEdgeMm;
  };
  phantom.p_focus_ct_mm = scene->T_ct_ear * Vector3d(1, 0, 10);
  phantom.n_view_ct = scene->T_ct_ear.linear().col(2);
  phantom.x_view_ct = scene->T_ct_ear.linear().col(1);
  return phantom;
}

}  // namespace holdfast::sim
