// SPDX-License-Identifier: Apache-2.0
// A textured, bone-like plane facing the camera, rendered at any rigid pose. The site *is* a cubic
// B-spline surface: its value is defined at every real point, so an image at a sub-pixel pose is
// exact, not interpolated from another image.
#pragma once

#include <cstdint>
#include <random>
#include <utility>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "bridge/camera_source.hpp"
#include "tests/sim/frame_source.hpp"
#include "tests/sim/trajectory.hpp"

namespace holdfast::sim {

struct SceneParameters {
  int width_px = 1920, height_px = 1080;  ///< the sensor
  double depth_mm = 200;                  ///< of the plane at the identity pose
  double um_per_px = 20;                  ///< at that depth; the focal length follows
  double margin_mm = 13;                  ///< textured beyond the field of view on each side
  double read_noise_dn = 1.2;             ///< standard deviation, of 255
  double shot_noise_dn = 0.12;            ///< of sqrt(value): sigma^2 = read^2 + shot^2 * value
  int glints = 0;                         ///< specular highlights that follow at half the motion
  std::uint32_t seed = 1;
};

class Scene {
 public:
  /// Throws InputError on a value out of range.
  explicit Scene(const SceneParameters& parameters);

  /// Renders at `T_camera_site`; the rest as FrameSource::render(). The fast path is pure
  /// translation parallel to the plane.
  void render(const SitePose& T_camera_site, const View& view, bridge::PixelFormat format,
              const cv::Rect& region, std::uint8_t* pixels);

  [[nodiscard]] const SceneParameters& parameters() const noexcept { return parameters_; }
  /// fx = fy; the principal point is the sensor's centre, (width - 1) / 2, (height - 1) / 2.
  [[nodiscard]] double focal_px() const noexcept;
  [[nodiscard]] Eigen::Vector2d principal_point_px() const noexcept;

 private:
  struct Glint {
    double x_px, y_px, radius_px;
  };
  void make_texture();
  void make_occluder();
  void make_glints();
  [[nodiscard]] const float* texture_row(int y) const noexcept;
  void filter_row(int y, int x0, int n, const float* weights, float* out) const noexcept;
  void begin_translation(const Eigen::Vector2d& shift_px, const cv::Rect& region);
  void translated_row(int row, int n);
  [[nodiscard]] float* ring_row(int row, int n) noexcept;
  [[nodiscard]] Eigen::Matrix3d texture_from_image(const SitePose& T_camera_site) const;
  void homography_row(const Eigen::Matrix3d& texture_of_image, int row, const cv::Rect& region);
  void add_glints(const Eigen::Vector2d& shift_px, int row, const cv::Rect& region);
  void occlude(int row, const cv::Rect& region);
  void write_row(const View& view, bridge::PixelFormat format, int row, const cv::Rect& region,
                 std::uint8_t* out);
  void expose_row(const float* light, std::pair<float, float> gains, bool has_noise, int n);
  void write_colour_row(const float* light, bool has_noise, int n, bool is_bgr, std::uint8_t* out);

  SceneParameters parameters_;
  int margin_px_ = 0, texture_width_ = 0, texture_height_ = 0;
  std::vector<float> texture_;   // B-spline coefficients, one a pixel, in DN of 255
  std::vector<float> occluder_;  // the sensor's size, DN of 255; below 0: see-through
  std::vector<float> noise_;     // normal deviates
  std::vector<Glint> glints_;
  std::vector<float> alternating_;  // +1, -1, +1...
  // One frame's constants and one row at a time.
  int x0_ = 0, y0_ = 0;
  float wx_[4] = {}, wy_[4] = {};
  std::vector<float> ring_;   // four texture rows, filtered along x
  std::vector<float> light_;  // before noise, DN of 255
  std::vector<float> noisy_;
  std::vector<std::uint8_t> planes_;  // three channels
  std::minstd_rand random_;
};

}  // namespace holdfast::sim
