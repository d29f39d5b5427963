// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/cavity_phantom_drill.hpp"

#include <algorithm>

#include "tests/sim/or/phantom_random.hpp"

namespace holdfast::sim {
namespace {

using Eigen::Vector3f;

constexpr float kBurrMm = 1.6F;  // between the marks that the burr leaves
constexpr float kBurrDepthMm = 0.25F;

constexpr float kCellMm = 3.F;
constexpr float kCellLevel = 0.3F;  // of the noise above which there is air: about a tenth

}  // namespace

DrilledCavity::DrilledCavity(std::uint32_t seed) : seed_(seed) {
  PhantomRandom random(0xd2111000ULL + seed);
  const auto vary = [&random](float middle, double by) {
    return middle + static_cast<float>(random.uniform(-by, by));
  };
  bowl_ = {vary(0.F, 0.5), vary(0.F, 0.5), vary(3.F, 0.5)};
  bowl_radii_ = {vary(13.5F, 1.0), vary(11.F, 0.8), vary(14.F, 0.8)};
  antrum_ = {vary(3.F, 0.7), vary(2.F, 0.7), vary(-11.F, 0.5)};
  antrum_radii_ = {vary(5.F, 0.5), vary(4.5F, 0.4), vary(5.F, 0.4)};
  middle_ear_ = {vary(11.F, 0.6), vary(-3.F, 0.6), vary(-17.F, 0.5)};
  const Vector3f facial_recess = 0.5F * (antrum_ + middle_ear_);
  tympanotomy_.emplace(std::vector<Tube::Node>{
      {antrum_, 3.F}, {facial_recess, vary(1.9F, 0.2)}, {middle_ear_, 2.4F}});
}

float DrilledCavity::distance(const Vector3f& p) const noexcept {
  float d =
      blend_union(ellipsoid(p, bowl_, bowl_radii_), ellipsoid(p, antrum_, antrum_radii_), 3.F);
  d = blend_union(d, tympanotomy_->distance_within(p, d + 3.F), 1.5F);
  d = blend_union(d, ellipsoid(p, middle_ear_, {3.8F, 3.3F, 2.8F}), 1.F);
  // Everything above the opening has gone, too.
  const Vector3f above{p.x() - bowl_.x(), p.y() - bowl_.y(), std::min(p.z() - bowl_.z(), 0.F)};
  d = std::min(d, ellipsoid(above, Vector3f::Zero(), bowl_radii_));
  return d > 2.F ? d : d + kBurrDepthMm * smooth_noise(p / kBurrMm, seed_);
}

float DrilledCavity::cellular_bone(const Vector3f& p) const noexcept {
  const float body = ellipsoid(p, {2.F, -1.F, -15.F}, {16.F, 13.F, 11.5F});
  if (body > 3.F) return body;
  const float cells = 2.5F * (smooth_noise(p / kCellMm, seed_ + 1) - kCellLevel);
  return std::max(body, cells);
}

}  // namespace holdfast::sim
