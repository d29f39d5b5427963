// SPDX-License-Identifier: Apache-2.0
// Images of a phantom as the stereo microscope takes them: rays through the true optics, light
// with real shadows, the point spread in and out of focus, and a sensor's noise.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "tests/sim/or/lights.hpp"
#include "tests/sim/or/optics.hpp"
#include "tests/sim/or/phantom.hpp"

namespace holdfast::sim {

/// Raised whenever the same shot gives other bytes: what was rendered before is made again.
constexpr int kRendererVersion = 2;

struct SensorParameters {
  double exposure = 1.0;
  double read_noise_dn = 1.0;  ///< standard deviation, of 255
  double shot_noise_dn = 0.1;  ///< of sqrt(value): sigma^2 = read^2 + shot^2 * value
  int bits = 8;                ///< 8 or 12
};

/// Which rays are cast.
enum class Rays {
  where_needed,  ///< none where what its neighbours found leaves nothing to be found
  all            ///< every pixel its own: what the other is tested against
};

/// One exposure of the room.
struct RoomShot {
  StereoOptics optics;
  Eigen::Isometry3d T_ct_head = Eigen::Isometry3d::Identity();
  Lights lights;
  ProjectorOptics projector;  ///< used where lights.pattern is not empty
  SensorParameters sensor;
  std::uint32_t seed = 1;  ///< of the noise; every shot needs its own
  Rays rays = Rays::where_needed;
  cv::Rect region{0, 0, kSensorWidthPx, kSensorHeightPx};  ///< what is read out of the sensor
};

enum class Side { left, right };

/// What is at each pixel, without light (evaluation and tests).
struct Geometry {
  cv::Mat_<float> depth_mm;  ///< along the camera's axis; 0: nothing there
  cv::Mat_<int> surface;     ///< index into Phantom::surfaces; -1: nothing
};

class Renderer {
 public:
  /// Takes over the surfaces (frame ct); the OR lamps hang in the direction `n_up_ct`. Throws
  /// InputError on a triangle that names no vertex, or normals or uv of another number than the
  /// vertices.
  Renderer(std::vector<LitSurface> surfaces, const Eigen::Vector3d& n_up_ct);
  ~Renderer();
  Renderer(const Renderer&) = delete;
  Renderer& operator=(const Renderer&) = delete;

  /// CV_8U, or CV_16U (0..4095) at 12 bits, of `shot.region`. The same shot gives the same bytes
  /// on the same kind of processor. Uses all cores; one thread at a time.
  [[nodiscard]] cv::Mat image(const RoomShot& shot, Side side);
  /// Light at the sensor before noise and rounding, CV_32F, DN of 255; not clipped.
  [[nodiscard]] cv::Mat light(const RoomShot& shot, Side side);
  /// Of the newest image() or light(), along the camera's axis; 0: nothing there. Until the next.
  [[nodiscard]] const cv::Mat_<float>& depth_mm() const;
  [[nodiscard]] Geometry geometry(const RoomShot& shot, Side side);
  /// The first surface point that the pixel's line of sight meets (frame ct).
  [[nodiscard]] std::optional<Eigen::Vector3d> first_hit(
      const SightLine& line, const Eigen::Isometry3d& T_ct_camera) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace holdfast::sim
