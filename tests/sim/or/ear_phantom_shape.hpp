// SPDX-License-Identifier: Apache-2.0
// An external ear as an implicit shape: helix with its rim curled over, scapha, antihelix with two
// crura, concha and canal, tragus, antitragus, lobule, on a stem. The seed varies all proportions.
#pragma once

#include <cstdint>
#include <vector>

#include "tests/sim/or/phantom_field.hpp"

namespace holdfast::sim {

/// Frame ear (mm): x towards the back of the head, y up, z out of the head; origin in the concha.
class EarShape {
 public:
  explicit EarShape(std::uint32_t seed);

  /// Negative inside; near the surface the distance to first order. Pure; any thread.
  [[nodiscard]] float distance(const Eigen::Vector3f& p_ear) const noexcept;

  /// Points along the groove under the curled rim: there, rays along -z meet the surface four
  /// times.
  [[nodiscard]] const std::vector<Eigen::Vector3f>& overhang() const noexcept { return overhang_; }

  /// Holds the ear down to the plane z = -4, where its stem stands on the base plate.
  [[nodiscard]] static Eigen::AlignedBox3f bounds();

 private:
  struct Proportions {
    float half_width, half_length, egg, lean, bowl_depth, rim_radius, relief, wave_sin, wave_cos;
  };
  [[nodiscard]] static Proportions draw(std::uint32_t seed);
  [[nodiscard]] Eigen::Vector2f outline(float angle_rad, float inset_mm) const;
  [[nodiscard]] float wave(float cosine, float sine) const noexcept;
  [[nodiscard]] float outline_distance(float x, float y) const noexcept;
  [[nodiscard]] float sheet_height(float x, float y) const noexcept;
  [[nodiscard]] float sheet(const Eigen::Vector3f& p) const noexcept;
  [[nodiscard]] Tube::Node node(float x, float y, float above_mm, float radius_mm) const;
  [[nodiscard]] Tube::Node rim_node(float angle_deg, float inset_mm, float above_mm,
                                    float radius_mm) const;
  [[nodiscard]] std::vector<Tube> make_ridges() const;
  [[nodiscard]] Tube make_rim(float inset_mm, float above_mm, float radius_mm, float from_deg,
                              float to_deg) const;

  Proportions shape_;
  Tube rim_, groove_, crus_;
  std::vector<Tube> ridges_;  // antihelix, its crura, antitragus, tragus
  Eigen::Vector3f lobule_;
  Tube canal_;
  std::vector<Eigen::Vector3f> overhang_;
};

}  // namespace holdfast::sim
