// SPDX-License-Identifier: Apache-2.0
// What the surgeon's burr has taken away: a mastoidectomy with posterior tympanotomy.
#pragma once

#include <cstdint>
#include <optional>

#include "tests/sim/or/phantom_field.hpp"

namespace holdfast::sim {

/// Frame site (mm): x forward, y up, z out of the head; origin where the drill enters the bone.
/// About 26 by 21 mm at the opening and 16 mm deep.
class DrilledCavity {
 public:
  explicit DrilledCavity(std::uint32_t seed);

  /// Negative where the drill has been. Pure; any thread.
  [[nodiscard]] float distance(const Eigen::Vector3f& p_site) const noexcept;

  /// Negative in the bone about the cavity that a head CT is too coarse to show: what it has as air
  /// or mush between cells, 3 mm wide on average. Pure; any thread.
  [[nodiscard]] float cellular_bone(const Eigen::Vector3f& p_site) const noexcept;

  /// z of the deepest point of the antrum.
  [[nodiscard]] float floor_mm() const noexcept { return antrum_.z() - antrum_radii_.z(); }
  [[nodiscard]] const Eigen::Vector3f& antrum() const noexcept { return antrum_; }

 private:
  std::uint32_t seed_;
  Eigen::Vector3f bowl_, bowl_radii_, antrum_, antrum_radii_, middle_ear_;
  std::optional<Tube> tympanotomy_;
};

}  // namespace holdfast::sim
