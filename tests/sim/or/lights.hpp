// SPDX-License-Identifier: Apache-2.0
// The room's light and the pattern projector. Irradiances are relative: 1 is what a white matt
// plate at the focus, facing the microscope, needs to fill the sensor's range at exposure 1.
#pragma once

#include <cstdint>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

namespace holdfast::sim {

struct Lights {
  double or_light = 0.35;         ///< lamps above the table and the room's walls
  double microscope_light = 0.6;  ///< beside the optical axis, from the objective
  cv::Mat pattern;                ///< CV_8U, 800x600, or larger by a whole factor; empty: off
  double pattern_power = 1.0;     ///< of a white projector pixel, at 740 nm
  double speckle = 0;             ///< contrast of the pattern's laser speckle, 0..1
  double scatter_mm = -1;         ///< subsurface scatter everywhere; below 0: as each Look says
};

constexpr int kProjectorWidthPx = 800;
constexpr int kProjectorHeightPx = 600;

/// The projector's own optics, beside the objective. Frame `projector`: as a camera's.
struct ProjectorOptics {
  Eigen::Vector3d p_head_mm;  ///< its pupil
  Eigen::Matrix3d R_head_projector;
  double focal_px = 0, cx_px = 0, cy_px = 0, k1 = 0;
  double focus_mm = 0, aperture_mm = 0, blur_px = 0;
  /// Where `p_head` is lit from, in projector pixels.
  [[nodiscard]] Eigen::Vector2d project(const Eigen::Vector3d& p_head_mm) const;
};

/// Aimed at the microscope's focus; where exactly it sits and looks is drawn from the seed.
[[nodiscard]] ProjectorOptics make_projector(std::uint32_t seed, double microscope_focus_mm);

/// What a diffractive element makes of a laser: round dots of `size_mm` at the focus, at random
/// places no closer than 1.2 sizes, `count` of them or as many as fit. 3200x2400, CV_8U.
[[nodiscard]] cv::Mat diffractive_dots(std::uint32_t seed, int count, double size_mm,
                                       const ProjectorOptics& projector);

}  // namespace holdfast::sim
