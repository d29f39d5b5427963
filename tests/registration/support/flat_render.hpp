// SPDX-License-Identifier: Apache-2.0
// Images of a printed plane under a known camera: area-sampled, blurred, with noise.
#pragma once

#include <cstdint>
#include <functional>
#include <random>
#include <vector>

#include <Eigen/Geometry>
#include <opencv2/imgproc.hpp>

namespace holdfast::registration::test {

struct FlatView {
  cv::Size size{640, 480};
  double f_px = 2400;
  Eigen::Isometry3d T_camera_plane = Eigen::Isometry3d::Identity();
  double blur_px = 1.0, noise = 2;
  std::uint32_t seed = 1;

  [[nodiscard]] cv::Matx33d camera_matrix() const {
    return {f_px, 0, 0.5 * (size.width - 1), 0, f_px, 0.5 * (size.height - 1), 0, 0, 1};
  }
  [[nodiscard]] cv::Point2d pixel(const Eigen::Vector3d& p_plane) const {
    const Eigen::Vector3d p = T_camera_plane * p_plane;
    return {f_px * p.x() / p.z() + 0.5 * (size.width - 1),
            f_px * p.y() / p.z() + 0.5 * (size.height - 1)};
  }
};

/// `print(x_mm, y_mm)`: grey value of the plane z = 0, called in order for 5x5 places a pixel.
inline cv::Mat render(const FlatView& view, const std::function<double(double, double)>& print) {
  constexpr int kSteps = 5;
  const Eigen::Isometry3d T_plane_camera = view.T_camera_plane.inverse();
  const Eigen::Vector3d eye = T_plane_camera.translation();
  cv::Mat image(view.size, CV_32F);
  for (int y = 0; y < image.rows; ++y)
    for (int x = 0; x < image.cols; ++x) {
      double sum = 0;
      for (int s = 0; s < kSteps * kSteps; ++s) {
        const double px = x + (s % kSteps + 0.5) / kSteps - 0.5;
        const double py = y + (s / kSteps + 0.5) / kSteps - 0.5;
        const Eigen::Vector3d ray =
            T_plane_camera.linear() * Eigen::Vector3d((px - 0.5 * (image.cols - 1)) / view.f_px,
                                                      (py - 0.5 * (image.rows - 1)) / view.f_px, 1);
        const Eigen::Vector3d p = eye - ray * (eye.z() / ray.z());
        sum += print(p.x(), p.y());
      }
      image.at<float>(y, x) = static_cast<float>(sum / (kSteps * kSteps));
    }
  if (view.blur_px > 0) cv::GaussianBlur(image, image, {}, view.blur_px);
  std::mt19937 random(view.seed);
  std::normal_distribution<double> normal(0, view.noise);
  cv::Mat grey(view.size, CV_8U);
  for (int y = 0; y < image.rows; ++y)
    for (int x = 0; x < image.cols; ++x)
      grey.at<std::uint8_t>(y, x) = cv::saturate_cast<std::uint8_t>(
          static_cast<double>(image.at<float>(y, x)) + normal(random));
  return grey;
}

}  // namespace holdfast::registration::test
