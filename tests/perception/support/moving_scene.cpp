// SPDX-License-Identifier: Apache-2.0
#include "tests/perception/support/moving_scene.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <stdexcept>

#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

namespace holdfast::test {
namespace {

constexpr int kTaps = 6;

std::array<float, kTaps> lanczos(double fraction) {
  std::array<float, kTaps> weights{};
  float sum = 0;
  for (int k = 0; k < kTaps; ++k) {
    const double x = (k - 2) - fraction, px = std::numbers::pi * x;
    const double w = std::abs(x) < 1e-9
                         ? 1
                         : (std::abs(x) >= 3 ? 0 : 3 * std::sin(px) * std::sin(px / 3) / (px * px));
    weights[static_cast<std::size_t>(k)] = static_cast<float>(w);
    sum += static_cast<float>(w);
  }
  for (float& w : weights) w /= sum;
  return weights;
}

/// Weights for 4096 fractions: 1/4096 px is far below anything measured here.
const std::array<float, kTaps>& weights_of(double fraction) {
  constexpr int kSteps = 4096;
  static const auto weight_table = [] {
    std::vector<std::array<float, kTaps>> table;
    for (int i = 0; i <= kSteps; ++i) table.push_back(lanczos(static_cast<double>(i) / kSteps));
    return table;
  }();
  return weight_table[static_cast<std::size_t>(std::lround(fraction * kSteps))];
}

template <int Channels>
void sample(const cv::Mat& texture, double u, double v, float* out) {
  const double x0 = std::floor(u), y0 = std::floor(v);
  const auto &wx = weights_of(u - x0), &wy = weights_of(v - y0);
  const int x = static_cast<int>(x0) - 2, y = static_cast<int>(y0) - 2;
  std::fill(out, out + Channels, 0.0F);
  for (int j = 0; j < kTaps; ++j) {
    const float* row = texture.ptr<float>(std::clamp(y + j, 0, texture.rows - 1));
    std::array<float, 3> sums{};
    for (int i = 0; i < kTaps; ++i) {
      const float* p = row + std::clamp(x + i, 0, texture.cols - 1) * Channels;
      for (std::size_t c = 0; c < Channels; ++c) sums[c] += wx[static_cast<std::size_t>(i)] * p[c];
    }
    for (std::size_t c = 0; c < Channels; ++c) out[c] += wy[static_cast<std::size_t>(j)] * sums[c];
  }
}

cv::Mat load(const std::string& path, bool in_colour) {
  const cv::Mat image = cv::imread(path, in_colour ? cv::IMREAD_COLOR : cv::IMREAD_GRAYSCALE);
  if (image.empty()) throw std::runtime_error(path + " is missing: install visp-images-data");
  cv::Mat smooth;
  image.convertTo(smooth, CV_32F);
  cv::GaussianBlur(smooth, smooth, cv::Size(), 0.8);
  return smooth;
}

}  // namespace

perception::CameraModel microscope_camera(int width_px, int height_px) {
  perception::CameraModel camera;
  camera.width_px = width_px;
  camera.height_px = height_px;
  camera.fx_px = camera.fy_px = 10000;
  camera.cx_px = 0.5 * width_px + 7.3;
  camera.cy_px = 0.5 * height_px - 4.1;
  return camera;
}

perception::CameraModel distorted_camera(int width_px, int height_px) {
  perception::CameraModel camera = microscope_camera(width_px, height_px);
  camera.fy_px = 9950;
  camera.distortion = (cv::Mat_<double>(1, 5) << -0.6, 0.3, 0.001, -0.0015, 0);
  return camera;
}

cv::Mat photograph(bool in_colour) {
  return load(visp_images + "Solvay/Solvay_conference_1927_Version2_2126x1463.png", in_colour);
}

cv::Mat other_photograph() {
  const cv::Mat small = load(visp_images + "Klimt/Klimt.png", false);
  cv::Mat tiled;
  cv::resize(small, tiled, cv::Size(2126, 1463), 0, 0, cv::INTER_CUBIC);
  return tiled;
}

MovingScene::MovingScene(const perception::CameraModel& camera, const cv::Mat& texture,
                         double depth_mm, double relief_mm)
    : camera_(camera), texture_(texture), depth_mm_(depth_mm), relief_mm_(relief_mm) {
  std::vector<cv::Point2d> pixels;
  for (int y = 0; y < camera.height_px; ++y)
    for (int x = 0; x < camera.width_px; ++x) pixels.emplace_back(x, y);
  rays_ = perception::to_normalised(camera, pixels);
}

double MovingScene::surface_mm(double x, double y) const {
  const double u = x * camera_.fx_px / 300, v = y * camera_.fy_px / 300;
  return depth_mm_ +
         relief_mm_ * (0.6 * std::sin(u + 0.4) * std::cos(0.8 * v) + 0.4 * std::sin(1.3 * v));
}

cv::Mat MovingScene::image(const Eigen::Isometry3d& T_camera_site, double noise,
                           std::uint64_t seed) const {
  const Eigen::Isometry3d T = T_camera_site.inverse(Eigen::Isometry);
  const Eigen::Vector3d o = T.translation();
  cv::Mat seen(camera_.height_px, camera_.width_px, CV_32FC(texture_.channels()));
  auto* out = seen.ptr<float>();
  for (const cv::Point2d& ray : rays_) {
    const Eigen::Vector3d d = T.linear() * Eigen::Vector3d(ray.x, ray.y, 1);
    Eigen::Vector3d p = o + (depth_mm_ - o.z()) / d.z() * d;
    for (int i = 0; relief_mm_ > 0 && i < 8; ++i)
      p += (surface_mm(p.x() / p.z(), p.y() / p.z()) - p.z()) / d.z() * d;
    const double u = p.x() / p.z() * camera_.fx_px + 0.5 * (texture_.cols - 1);
    const double v = p.y() / p.z() * camera_.fy_px + 0.5 * (texture_.rows - 1);
    texture_.channels() == 3 ? sample<3>(texture_, u, v, out) : sample<1>(texture_, u, v, out);
    out += texture_.channels();
  }
  if (noise > 0) {
    cv::RNG random(seed);
    cv::Mat grain(seen.size(), seen.type());
    random.fill(grain, cv::RNG::NORMAL, 0, noise);
    seen += grain;
  }
  cv::Mat image;
  seen.convertTo(image, CV_8U);
  return image;
}

cv::Mat MovingScene::depth_mm() const {
  cv::Mat depth(camera_.height_px, camera_.width_px, CV_32FC1);
  for (int y = 0; y < depth.rows; ++y)
    for (int x = 0; x < depth.cols; ++x)
      depth.at<float>(y, x) = static_cast<float>(
          surface_mm((x - camera_.cx_px) / camera_.fx_px, (y - camera_.cy_px) / camera_.fy_px));
  return depth;
}

perception::SiteDepth MovingScene::wide_depth(int beside_px) const {
  perception::SiteDepth wide;
  wide.grid = perception::PixelGrid{camera_.fx_px, camera_.fy_px, camera_.cx_px + beside_px,
                                    camera_.cy_px + beside_px};
  wide.depth_mm =
      cv::Mat(camera_.height_px + 2 * beside_px, camera_.width_px + 2 * beside_px, CV_32FC1);
  for (int y = 0; y < wide.depth_mm.rows; ++y)
    for (int x = 0; x < wide.depth_mm.cols; ++x)
      wide.depth_mm.at<float>(y, x) = static_cast<float>(surface_mm(
          (x - wide.grid->cx_px) / wide.grid->fx_px, (y - wide.grid->cy_px) / wide.grid->fy_px));
  return wide;
}

Eigen::Isometry3d moved_about(const Eigen::Vector3d& pivot_mm, const Eigen::Vector3d& t_mm,
                              const Eigen::Vector3d& r_rad) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  if (r_rad.norm() > 0)
    T.linear() = Eigen::AngleAxisd(r_rad.norm(), r_rad.normalized()).toRotationMatrix();
  T.translation() = pivot_mm + t_mm - T.linear() * pivot_mm;
  return T;
}

Eigen::Matrix<double, 6, 1> error_of(const perception::MotionEstimate& estimate,
                                     const Eigen::Isometry3d& T_camera_site) {
  const Eigen::Isometry3d& T = estimate.T_camera_site;
  const Eigen::AngleAxisd turn(T_camera_site.linear() * T.linear().transpose());
  const Eigen::Vector3d& p_site = estimate.p_pivot_site_mm;
  Eigen::Matrix<double, 6, 1> error;
  error << T_camera_site * p_site - T * p_site, turn.angle() * turn.axis();
  return error;
}

}  // namespace holdfast::test
