// SPDX-License-Identifier: Apache-2.0
// From a shot, as its caller describes it, to what the kernel needs.
#pragma once

#include <array>
#include <vector>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "tests/sim/or/kernel/kernel.hpp"
#include "tests/sim/or/lit_scene.hpp"
#include "tests/sim/or/renderer.hpp"

namespace holdfast::sim {

/// The pattern as it leaves the projector: twice its pixels, in three stages of blur. Made once for
/// a pattern and kept.
class ProjectedPattern {
 public:
  static constexpr int kScale = 2;
  /// Does nothing when it already holds this pattern with this blur.
  void prepare(const cv::Mat& pattern, double blur_px);
  [[nodiscard]] const std::array<cv::Mat_<float>, 3>& levels() const noexcept { return levels_; }
  [[nodiscard]] double variance(std::size_t level) const noexcept;  ///< in px of the levels

 private:
  std::array<cv::Mat_<float>, 3> levels_;
  double blur_px_ = 0;
  cv::Mat pattern_;
};

/// Holds the arrays that `frame` points to.
class FrameSetup {
 public:
  /// For `shot` through the camera of `side`. Valid as long as scene and pattern live.
  void prepare(const RoomShot& shot, Side side, const LitScene& scene, ProjectedPattern& pattern);

  [[nodiscard]] const kernel::Frame& frame() const noexcept { return frame_; }
  [[nodiscard]] const OpticalChannel& channel() const noexcept { return *channel_; }
  /// 1/depth of the plane of focus at a pixel, by its slopes.
  [[nodiscard]] const Eigen::Vector3d& inverse_focus() const noexcept { return inverse_focus_; }
  /// Slopes (x, y) at the centre of a pixel of the sensor.
  [[nodiscard]] Eigen::Vector2d slopes_at(double x, double y) const;

 private:
  void prepare_camera(const RoomShot& shot, Side side);
  void prepare_lights(const RoomShot& shot, ProjectedPattern& pattern);

  kernel::Frame frame_{};
  const OpticalChannel* channel_ = nullptr;
  std::vector<float> slopes_;
  Eigen::Vector3d inverse_focus_ = Eigen::Vector3d::Zero();
};

}  // namespace holdfast::sim
