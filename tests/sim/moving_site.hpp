// SPDX-License-Identifier: Apache-2.0
// The scene in motion: knows the true pose of the site at every instant.
#pragma once

#include <chrono>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <vector>

#include "tests/sim/frame_source.hpp"
#include "tests/sim/scene.hpp"
#include "tests/sim/trajectory.hpp"

namespace holdfast::sim {

class MovingSite : public FrameSource {
 public:
  /// The program starts at `t_start` (CLOCK_MONOTONIC); `scale` and `loop` as in Trajectory, also
  /// for programs set later.
  MovingSite(const SceneParameters& scene, std::string_view program, double scale, bool loop,
             std::chrono::nanoseconds t_start);

  /// From `t` on the site first returns to the identity pose (2 mm/s, at most 5 deg/s), then
  /// follows `program`. Any thread. Throws InputError and changes nothing when the program is
  /// wrong.
  void set_program(std::string_view program, std::chrono::nanoseconds t);

  /// T_camera_site at `t`. Any thread.
  [[nodiscard]] SitePose pose_at(std::chrono::nanoseconds t) const;
  struct Start {
    std::chrono::nanoseconds t;  ///< CLOCK_MONOTONIC
    std::string name;
  };
  /// The segments that begin in [from, to). Any thread.
  [[nodiscard]] std::vector<Start> starts(std::chrono::nanoseconds from,
                                          std::chrono::nanoseconds to) const;

  [[nodiscard]] const Scene& scene() const noexcept { return scene_; }
  [[nodiscard]] cv::Size sensor_px() const noexcept override;
  void render(std::chrono::nanoseconds t_mid_exposure, const View& view, bridge::PixelFormat format,
              const cv::Rect& region, std::uint8_t* pixels) override;

 private:
  struct Program {
    std::chrono::nanoseconds t_start;  ///< of the way home
    SitePose from;
    double home_s;
    Trajectory trajectory;
  };
  [[nodiscard]] const Program& program_at(std::chrono::nanoseconds t) const;
  [[nodiscard]] SitePose locked_pose_at(std::chrono::nanoseconds t) const;

  Scene scene_;
  double scale_;
  bool loop_;
  mutable std::mutex mutex_;
  std::vector<std::unique_ptr<Program>> programs_;  // in order of t_start
};

}  // namespace holdfast::sim
