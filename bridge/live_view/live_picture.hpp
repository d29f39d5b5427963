// SPDX-License-Identifier: Apache-2.0
// What the camera sees and what the tracker says of it, for eyes: a small copy of one tracked
// frame. It leaves the daemon as a file of a fixed layout (docs/interfaces.md, "Live view").
//
// Pixels of the picture count from 0 at the centre of the first; `factor` of the camera's make one,
// so that a camera's pixel u lies at (u + 0.5) / factor - 0.5.
#pragma once

#include <chrono>
#include <cstdint>
#include <vector>

#include "perception/motion_estimate.hpp"

namespace holdfast::bridge {

struct LivePoint {
  float x_px, y_px;
};

struct LivePicture {
  std::uint64_t frame = 0;                ///< as in TrackingHealth
  std::chrono::nanoseconds t_exposure{};  ///< mid-exposure, the daemon's CLOCK_MONOTONIC
  std::chrono::nanoseconds t_utc{};       ///< the same instant since 1970-01-01

  int width_px = 0, height_px = 0;                    ///< multiples of kLiveMaskCellPx
  int channels = 1;                                   ///< 1 grey, 3 red, green, blue
  int factor = 1;                                     ///< camera's pixels a pixel, each way
  int camera_width_px = 0, camera_height_px = 0;      ///< less than `factor` x 4 more than is shown
  double fx_px = 1, fy_px = 1, cx_px = 0, cy_px = 0;  ///< of the camera, in its own pixels
  double plane_depth_mm = 0;  ///< of the site on the axis at the keyframe; 0: not known yet

  perception::TrackingStatus status = perception::TrackingStatus::lost;
  perception::TrackingReason reason = perception::TrackingReason::no_keyframe;
  int inliers = 0, visible = 0;  ///< patches with a say, of those in view
  /// Where the site's point on the axis was at the keyframe, and is now; picture's pixels.
  bool has_motion = false;
  LivePoint from{}, to{};

  /// Patches with a say, picture's pixels; empty also where the tracker cannot tell.
  std::vector<LivePoint> points;
  /// width/4 x height/4: how much of each 4x4 pixels the reflection mask takes, 0 to 255.
  std::vector<std::uint8_t> mask;
  std::vector<std::uint8_t> pixels;  ///< row by row, channels together

  [[nodiscard]] float of_camera_px(double camera_px) const noexcept {
    return static_cast<float>((camera_px + 0.5) / factor - 0.5);
  }
};

inline constexpr int kLiveMaskCellPx = 4;
inline constexpr int kLiveSideMinPx = 16, kLiveSideMaxPx = 1280;
inline constexpr int kLiveFactorMax = 64;
inline constexpr int kLiveCameraSideMaxPx = 16384;
inline constexpr std::size_t kLivePointsMax = 512;

}  // namespace holdfast::bridge
