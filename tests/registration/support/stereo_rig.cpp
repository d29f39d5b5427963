// SPDX-License-Identifier: Apache-2.0
#include "tests/registration/support/stereo_rig.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include <opencv2/calib3d.hpp>

namespace holdfast::test {
namespace {

/// 0 … 1, the same for the same cell.
double chance(std::int64_t i, std::int64_t j, std::uint32_t seed, std::uint32_t which) {
  std::uint64_t h = static_cast<std::uint64_t>(i) * 0x9e3779b97f4a7c15ULL +
                    static_cast<std::uint64_t>(j) * 0xc2b2ae3d27d4eb4fULL + seed * 0x165667b1ULL +
                    which * 0x27d4eb2fULL;
  h = (h ^ (h >> 31)) * 0xbf58476d1ce4e5b9ULL;
  h = (h ^ (h >> 27)) * 0x94d049bb133111ebULL;
  return static_cast<double>((h ^ (h >> 31)) >> 11) / 9007199254740992.0;
}

}  // namespace

registration::ZoomCalibration StereoRig::calibration() const {
  registration::ZoomCalibration zoom;
  zoom.zoom = 1;
  zoom.focus_mm = distance_mm;
  zoom.camera_matrix_left = {
      focal_px, 0, image_px.width / 2.0 + 3, 0, focal_px, image_px.height / 2.0 - 2, 0, 0, 1};
  zoom.camera_matrix_right = {focal_px * 1.002,
                              0,
                              image_px.width / 2.0 - 4,
                              0,
                              focal_px * 1.002,
                              image_px.height / 2.0 + 1,
                              0,
                              0,
                              1};
  zoom.distortion_left = (cv::Mat_<double>(1, 5) << distortion_k1, 0.01, 0.0005, -0.0003, 0);
  zoom.distortion_right = (cv::Mat_<double>(1, 5) << 0.9 * distortion_k1, 0, -0.0002, 0.0004, 0);
  const double half = std::asin(baseline_mm / 2 / distance_mm);
  const cv::Vec3d centre(baseline_mm * std::cos(half), 0, baseline_mm * std::sin(half));
  cv::Matx33d R_;
  cv::Rodrigues(cv::Vec3d(pitch_rad, 2 * half, 0.003), R_);  // a little roll and pitch besides
  zoom.R = R_;
  zoom.T = -(R_ * centre);
  return zoom;
}

double StereoRig::height_mm(double x_mm, double y_mm) const {
  return distance_mm + relief_mm * std::sin(0.25 * x_mm + 0.4) * std::cos(0.21 * y_mm) +
         0.15 * x_mm - 0.1 * y_mm;
}

cv::Vec3d StereoRig::meet(const cv::Vec3d& origin_mm, const cv::Vec3d& direction) const {
  double t = (distance_mm - origin_mm[2]) / direction[2];
  for (int i = 0; i < 12; ++i) {
    const cv::Vec3d p = origin_mm + t * direction;
    const double step = (height_mm(p[0], p[1]) - p[2]) / direction[2];
    t += step;
    if (std::abs(step) < 1e-10) break;
  }
  return origin_mm + t * direction;
}

double StereoRig::grey(double x_mm, double y_mm) const {
  const double c = std::cos(dots_turn_rad), s = std::sin(dots_turn_rad);
  const double u = c * x_mm - s * y_mm + dots_shift_mm, v = s * x_mm + c * y_mm;
  const auto i0 = static_cast<std::int64_t>(std::floor(u / dot_pitch_mm));
  const auto j0 = static_cast<std::int64_t>(std::floor(v / dot_pitch_mm));
  const double blur_mm = 1.5 * distance_mm / focal_px;
  double dots = 0;
  for (std::int64_t j = j0 - 1; j <= j0 + 1; ++j)
    for (std::int64_t i = i0 - 1; i <= i0 + 1; ++i) {
      if (!is_lattice && chance(i, j, seed, 0) < 0.5) continue;
      const double jitter = is_lattice ? 0 : 0.5;
      const double dx =
          (static_cast<double>(i) + 0.5 + jitter * (chance(i, j, seed, 1) - 0.5)) * dot_pitch_mm -
          u;
      const double dy =
          (static_cast<double>(j) + 0.5 + jitter * (chance(i, j, seed, 2) - 0.5)) * dot_pitch_mm -
          v;
      const double edge = (std::hypot(dx, dy) - dot_radius_mm) / blur_mm;
      if (edge < 4) dots = std::max(dots, 0.5 * std::erfc(edge / std::sqrt(2.0)));
    }
  const double texture = std::sin(3.1 * x_mm + 2 * std::sin(1.7 * y_mm)) * std::cos(2.3 * y_mm);
  return ambient_grey + contrast_grey * dots + texture_grey * texture;
}

cv::Mat1b StereoRig::view(bool is_left) const {
  const registration::ZoomCalibration zoom = calibration();
  std::vector<cv::Point2d> pixels, rays;
  for (int y = 0; y < image_px.height; ++y)
    for (int x = 0; x < image_px.width; ++x) pixels.emplace_back(x, y);
  cv::undistortPoints(pixels, rays, is_left ? zoom.camera_matrix_left : zoom.camera_matrix_right,
                      is_left ? zoom.distortion_left : zoom.distortion_right, cv::noArray(),
                      cv::noArray(), cv::TermCriteria(cv::TermCriteria::COUNT, 20, 0));
  const cv::Matx33d R_camera = is_left ? cv::Matx33d::eye() : cv::Matx33d(zoom.R.t());
  const cv::Vec3d origin = is_left ? cv::Vec3d(0, 0, 0) : cv::Vec3d(-(zoom.R.t() * zoom.T));
  cv::Mat1f noise(image_px);
  cv::RNG random(seed * 2 + (is_left ? 1 : 0));
  random.fill(noise, cv::RNG::NORMAL, 0, noise_grey);
  cv::Mat1b image(image_px);
  for (int i = 0; i < image_px.area(); ++i) {
    const cv::Point2d& ray = rays[static_cast<std::size_t>(i)];
    const cv::Vec3d p = meet(origin, R_camera * cv::Vec3d(ray.x, ray.y, 1));
    const int x = i % image_px.width, y = i / image_px.width;
    image(y, x) = cv::saturate_cast<uchar>(grey(p[0], p[1]) * (is_left ? 1 : 0.95) +
                                           static_cast<double>(noise(y, x)));
  }
  return image;
}

double StereoRig::true_depth_mm(const registration::Rectification& geometry, double x_px,
                                double y_px) const {
  const cv::Vec3d ray((x_px - geometry.P1(0, 2)) / geometry.P1(0, 0),
                      (y_px - geometry.P1(1, 2)) / geometry.P1(1, 1), 1);
  const cv::Vec3d p_camera = meet({0, 0, 0}, geometry.R1.t() * ray);
  return (geometry.R1 * p_camera)[2];
}

}  // namespace holdfast::test
