// SPDX-License-Identifier: Apache-2.0
// A textured, bone-like plane facing the camera, rendered at any rigid pose. The site *is* a cubic
// B-spline surface: its value is defined at every real point, so an image at a sub-pixel pose is
// exact, not interpolated from another image.
#pragma once

#include <cstdint>
#include <random>
#include <string>
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
  void translated_rows(const Eigen::Vector2d& shift_px, const cv::Rect& region);
  void homography_rows(const Eigen::Matrix3d& H_texture_image, const cv::Rect& region);
  void add_glints(const Eigen::Vector2d& shift_px, const cv::Rect& region);
  void occlude(const cv::Rect& region);
  void write(const View& view, bridge::PixelFormat format, const cv::Rect& region,
             std::uint8_t* pixels);

  SceneParameters parameters_;
  int margin_px_ = 0, texture_width_ = 0, texture_height_ = 0;
  std::vector<float> texture_;   // B-spline coefficients, one a pixel, in DN of 255
  std::vector<float> occluder_;  // the sensor's size, DN of 255; below 0: see-through
  std::vector<float> noise_;     // normal deviates
  std::vector<Glint> glints_;
  std::vector<float> light_;  // the rendered region before noise, DN of 255
  std::vector<float> noisy_;  // one row
  std::minstd_rand random_;
};

}  // namespace holdfast::sim
