// SPDX-License-Identifier: Apache-2.0
// What comes between the site and a steady, sharp picture of it, over a sequence's time: the lamp
// flickers, the picture loses its focus, the zoom is turned, blood spreads on the site, smoke
// drifts past, and an instrument is held before everything. Of light before the sensor's noise, so
// that noise stays the sensor's.
#pragma once

#include <cstdint>
#include <optional>
#include <string_view>
#include <vector>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "tests/sim/or/renderer.hpp"

namespace holdfast::sim {

class Disturbances {
 public:
  /// Reads a program such as "smoke:1:3,flicker:0.5:2:1.5": NAME:FROM_S:FOR_S[:STRENGTH].
  ///   flicker    the lamp's brightness swings by 25 % times strength, twice a second and 7.3 times
  ///   defocus    out of focus by a blur of 4 px times strength in the middle of the time
  ///   zoom       the zoom is STRENGTH (which must be given)
  ///   blood      runs out of four places of the site, 6 mm wide times strength at the end of the
  ///              time, and stays; it moves with the site
  ///   smoke      drifts across, comes and goes; at its thickest a fifth of the light comes through
  ///              on average (strength 1), and it shines itself
  ///   occlusion  something dark, out of focus and not quite at rest comes in from the right within
  ///              .2 s, covers everything, and leaves within .2 s at the end of the time
  /// An empty program disturbs nothing. Throws InputError naming the item.
  explicit Disturbances(std::string_view program);

  [[nodiscard]] bool is_empty() const noexcept { return items_.empty(); }
  /// At `t_s`; none: as it was.
  [[nodiscard]] std::optional<double> zoom(double t_s) const;
  /// Before the shot is rendered: what is of the lamp and of the lens.
  void set(RoomShot& shot, double t_s) const;
  /// What the rendered light is of.
  struct Seen {
    const RoomShot& shot;
    const cv::Mat_<float>& depth_mm;      ///< Renderer::depth_mm()
    Eigen::Isometry3d T_ct_camera;        ///< now
    Eigen::Isometry3d T_ct_camera_first;  ///< at the sequence's begin
  };
  /// After it was rendered (DN of 255): what is before the lens, and on the site.
  void draw(cv::Mat_<float>& light, const Seen& seen, double t_s) const;

 private:
  enum class Kind : std::uint8_t { flicker, defocus, zoom, blood, smoke, occlusion };
  struct Item {
    Kind kind;
    double from_s, for_s, strength;
  };
  [[nodiscard]] static Item item_of(std::string_view text);
  std::vector<Item> items_;
};

}  // namespace holdfast::sim
