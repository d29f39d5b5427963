// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/scene.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include <Eigen/LU>
#include <fmt/core.h>
#include <opencv2/imgproc.hpp>

#include "rt/core/error.hpp"

namespace holdfast::sim {
namespace {

using bridge::PixelFormat;

constexpr std::size_t kNoiseSize = std::size_t{1} << 20U;
constexpr float kDarkLevel = 2;  // the black level that is left without light
// Bone under a white lamp: how much of the light each channel returns.
constexpr float kBlue = 0.74F, kGreen = 0.88F, kRed = 1.0F;

// Uniform cubic B-spline: weights of the four coefficients around a point at fraction `f`.
void spline_weights(double f, float* weights) {
  const double g = 1 - f;
  weights[0] = static_cast<float>(g * g * g / 6);
  weights[1] = static_cast<float>((3 * f * f * f - 6 * f * f + 4) / 6);
  weights[2] = static_cast<float>((3 * g * g * g - 6 * g * g + 4) / 6);
  weights[3] = static_cast<float>(f * f * f / 6);
}

cv::Mat octave(int width, int height, int cell_px, cv::RNG& random) {
  cv::Mat coarse(height / cell_px + 4, width / cell_px + 4, CV_32F);
  random.fill(coarse, cv::RNG::NORMAL, 0, 1);
  if (cell_px == 1) return coarse(cv::Rect(0, 0, width, height)).clone();
  cv::Mat fine;
  cv::resize(coarse, fine, {}, cell_px, cell_px, cv::INTER_CUBIC);
  return fine(cv::Rect(0, 0, width, height)).clone();
}

}  // namespace

Scene::Scene(const SceneParameters& parameters)
    : parameters_(parameters), random_(parameters.seed) {
  const auto require = [](bool is_valid, const char* what) {
    if (!is_valid) throw InputError(fmt::format("scene: {}", what));
  };
  require(parameters.width_px >= 16 && parameters.width_px <= 8192, "width must be in 16..8192 px");
  require(parameters.height_px >= 16 && parameters.height_px <= 8192,
          "height must be in 16..8192 px");
  require(parameters.depth_mm > 0, "depth must be positive (mm)");
  require(parameters.um_per_px > 0, "pixel pitch at the site must be positive (um)");
  require(parameters.read_noise_dn >= 0 && parameters.shot_noise_dn >= 0,
          "noise must not be negative");
  margin_px_ = static_cast<int>(std::ceil(parameters.margin_mm * 1e3 / parameters.um_per_px)) + 4;
  texture_width_ = parameters.width_px + 2 * margin_px_;
  texture_height_ = parameters.height_px + 2 * margin_px_;
  make_texture();
  make_occluder();
  make_glints();
  std::mt19937 generator(parameters.seed + 1);
  std::normal_distribution<float> normal;
  noise_.resize(kNoiseSize);
  for (float& value : noise_) value = normal(generator);
}

double Scene::focal_px() const noexcept {
  return parameters_.depth_mm * 1e3 / parameters_.um_per_px;
}

Eigen::Vector2d Scene::principal_point_px() const noexcept {
  return {(parameters_.width_px - 1) / 2.0, (parameters_.height_px - 1) / 2.0};
}

// Bone: soft undulation, grain at several scales, dark pores and fine vessels' dots.
void Scene::make_texture() {
  cv::RNG random(parameters_.seed);
  cv::Mat sum(texture_height_, texture_width_, CV_32F, cv::Scalar(150));
  const std::pair<int, double> octaves[] = {{128, 14}, {32, 12}, {12, 12}, {5, 14}, {2, 10}};
  for (const auto& [cell_px, contrast] : octaves)
    cv::scaleAdd(octave(texture_width_, texture_height_, cell_px, random), contrast, sum, sum);
  const int pores = texture_width_ * texture_height_ / 2500;
  for (int i = 0; i < pores; ++i) {
    const cv::Point centre(random.uniform(0, texture_width_), random.uniform(0, texture_height_));
    const cv::Size axes(random.uniform(2, 9), random.uniform(2, 6));
    cv::ellipse(sum, centre, axes, random.uniform(0, 180), 0, 360,
                cv::Scalar(random.uniform(40, 110)), cv::FILLED);
  }
  cv::GaussianBlur(sum, sum, {0, 0}, 0.8);
  sum = cv::min(cv::max(sum, 12.0), 235.0);
  texture_.assign(sum.ptr<float>(), sum.ptr<float>() + sum.total());
}

// A glove: a broad hand with fingers coming in from the right, wrinkled, over four fifths.
void Scene::make_occluder() {
  const int width = parameters_.width_px, height = parameters_.height_px;
  cv::RNG random(parameters_.seed + 7);
  cv::Mat glove(height, width, CV_32F, cv::Scalar(178));
  for (const auto& [cell_px, contrast] :
       {std::pair{64, 16.0}, std::pair{16, 9.0}, std::pair{4, 5.0}})
    cv::scaleAdd(octave(width, height, cell_px, random), contrast, glove, glove);
  cv::Mat hand = cv::Mat::zeros(height, width, CV_8U);
  cv::rectangle(hand, {width * 3 / 10, 0}, {width, height}, 255, cv::FILLED);
  for (int finger = 0; finger < 4; ++finger)
    cv::ellipse(hand, {width * 3 / 10, height * (2 * finger + 1) / 8}, {width / 4, height / 9}, 0,
                0, 360, 255, cv::FILLED);
  glove = cv::min(cv::max(glove, 12.0), 240.0);
  glove.setTo(-1, hand == 0);
  occluder_.assign(glove.ptr<float>(), glove.ptr<float>() + glove.total());
}

void Scene::make_glints() {
  cv::RNG random(parameters_.seed + 11);
  for (int i = 0; i < parameters_.glints; ++i)
    glints_.push_back({random.uniform(0.05, 0.95) * parameters_.width_px,
                       random.uniform(0.05, 0.95) * parameters_.height_px,
                       random.uniform(4.0, 18.0)});
}

const float* Scene::texture_row(int y) const noexcept {
  const int clamped = std::clamp(y, 0, texture_height_ - 1);
  return texture_.data() + static_cast<std::ptrdiff_t>(clamped) * texture_width_;
}

// out[i] = spline along row `y` at x0 + i + fraction. Beyond the texture its edge goes on.
void Scene::filter_row(int y, int x0, int n, const float* weights, float* out) const noexcept {
  const float* row = texture_row(y);
  const auto edge = [&](int x) { return row[std::clamp(x, 0, texture_width_ - 1)]; };
  const int begin = std::clamp(1 - x0, 0, n), end = std::clamp(texture_width_ - 2 - x0, begin, n);
  const auto slow = [&](int i) {
    out[i] = 0;
    for (int k = 0; k < 4; ++k) out[i] += weights[k] * edge(x0 + i - 1 + k);
  };
  for (int i = 0; i < begin; ++i) slow(i);
  const float* from = row + x0 - 1;
  const float a = weights[0], b = weights[1], c = weights[2], d = weights[3];
  for (int i = begin; i < end; ++i)
    out[i] = a * from[i] + b * from[i + 1] + c * from[i + 2] + d * from[i + 3];
  for (int i = end; i < n; ++i) slow(i);
}

// Pure translation: one set of weights for all pixels, each texture row filtered once.
void Scene::translated_rows(const Eigen::Vector2d& shift_px, const cv::Rect& region) {
  const double x = region.x - shift_px.x() + margin_px_, y = region.y - shift_px.y() + margin_px_;
  const int x0 = static_cast<int>(std::floor(x)), y0 = static_cast<int>(std::floor(y));
  float wx[4], wy[4];
  spline_weights(x - x0, wx);
  spline_weights(y - y0, wy);
  const int n = region.width;
  std::vector<float> ring(static_cast<std::size_t>(n) * 4);
  const auto slot = [&](int row) { return ring.data() + static_cast<std::ptrdiff_t>(row & 3) * n; };
  for (int row = -1; row <= 1; ++row) filter_row(y0 + row, x0, n, wx, slot(row));
  for (int row = 0; row < region.height; ++row) {
    filter_row(y0 + row + 2, x0, n, wx, slot(row + 2));
    const float *r0 = slot(row - 1), *r1 = slot(row), *r2 = slot(row + 1), *r3 = slot(row + 2);
    float* out = light_.data() + static_cast<std::ptrdiff_t>(row) * n;
    for (int i = 0; i < n; ++i)
      out[i] = wy[0] * r0[i] + wy[1] * r1[i] + wy[2] * r2[i] + wy[3] * r3[i];
  }
}

// Any rigid pose: each pixel's own sixteen coefficients.
void Scene::homography_rows(const Eigen::Matrix3d& H_texture_image, const cv::Rect& region) {
  for (int row = 0; row < region.height; ++row) {
    float* out = light_.data() + static_cast<std::ptrdiff_t>(row) * region.width;
    for (int column = 0; column < region.width; ++column) {
      const Eigen::Vector3d p =
          H_texture_image * Eigen::Vector3d(region.x + column, region.y + row, 1);
      const double x = std::clamp(p.x() / p.z(), 2.0, texture_width_ - 4.0);
      const double y = std::clamp(p.y() / p.z(), 2.0, texture_height_ - 4.0);
      const int x0 = static_cast<int>(x), y0 = static_cast<int>(y);
      float wx[4], wy[4], sum = 0;
      spline_weights(x - x0, wx);
      spline_weights(y - y0, wy);
      const float* from = texture_row(y0 - 1) + x0 - 1;
      for (int k = 0; k < 4; ++k, from += texture_width_)
        sum += wy[k] * (wx[0] * from[0] + wx[1] * from[1] + wx[2] * from[2] + wx[3] * from[3]);
      out[column] = sum;
    }
  }
}

void Scene::add_glints(const Eigen::Vector2d& shift_px, const cv::Rect& region) {
  for (const Glint& glint : glints_) {
    const double x = glint.x_px + 0.5 * shift_px.x() - region.x;
    const double y = glint.y_px + 0.5 * shift_px.y() - region.y;
    const int reach = static_cast<int>(3 * glint.radius_px);
    for (int row = std::max(0, static_cast<int>(y) - reach);
         row < std::min(region.height, static_cast<int>(y) + reach); ++row)
      for (int column = std::max(0, static_cast<int>(x) - reach);
           column < std::min(region.width, static_cast<int>(x) + reach); ++column) {
        const double d2 = (column - x) * (column - x) + (row - y) * (row - y);
        light_[static_cast<std::size_t>(row * region.width + column)] +=
            static_cast<float>(400 * std::exp(-d2 / (0.5 * glint.radius_px * glint.radius_px)));
      }
  }
}

void Scene::occlude(const cv::Rect& region) {
  for (int row = 0; row < region.height; ++row) {
    const float* glove = occluder_.data() +
                         static_cast<std::ptrdiff_t>(row + region.y) * parameters_.width_px +
                         region.x;
    float* out = light_.data() + static_cast<std::ptrdiff_t>(row) * region.width;
    for (int i = 0; i < region.width; ++i) out[i] = glove[i] >= 0 ? glove[i] : out[i];
  }
}

namespace {

template <typename Sample>
void quantise(const float* from, std::ptrdiff_t stride, int n, float scale, float highest,
              Sample* out) {
  for (int i = 0; i < n; ++i) {
    const float value = from[i] * scale + 0.5F;
    const float bounded = value < 0 ? 0 : (value > highest ? highest : value);
    out[i * stride] = static_cast<Sample>(static_cast<int>(bounded));
  }
}

// What each pixel of a mosaic's row sees, in the order of its columns.
void mosaic_gains(PixelFormat format, int row, float* gains) {
  const bool odd = (row & 1) != 0;
  switch (format) {
    case PixelFormat::bayer_rg8:
      gains[0] = odd ? kGreen : kRed, gains[1] = odd ? kBlue : kGreen;
      return;
    case PixelFormat::bayer_gb8:
      gains[0] = odd ? kRed : kGreen, gains[1] = odd ? kGreen : kBlue;
      return;
    case PixelFormat::bayer_gr8:
      gains[0] = odd ? kBlue : kGreen, gains[1] = odd ? kGreen : kRed;
      return;
    default:  // bayer_bg8
      gains[0] = odd ? kGreen : kBlue, gains[1] = odd ? kRed : kGreen;
      return;
  }
}

}  // namespace

void Scene::write(const View& view, PixelFormat format, const cv::Rect& region,
                  std::uint8_t* pixels) {
  const int n = region.width;
  const auto read2 = static_cast<float>(parameters_.read_noise_dn * parameters_.read_noise_dn);
  const auto shot2 = static_cast<float>(parameters_.shot_noise_dn * parameters_.shot_noise_dn);
  const auto expose = [&](const float* light, float even_gain, float odd_gain) {
    const float* noise = noise_.data() + random_() % (kNoiseSize - static_cast<std::size_t>(n));
    const float gains[2] = {even_gain, odd_gain};
    for (int i = 0; i < n; ++i) {
      const float value = light[i] * (i & 1 ? gains[1] : gains[0]);
      const float sigma = view.has_noise ? std::sqrt(read2 + shot2 * value) : 0.0F;
      noisy_[static_cast<std::size_t>(i)] = value + sigma * noise[i];
    }
  };
  for (int row = 0; row < region.height; ++row) {
    const float* light = light_.data() + static_cast<std::ptrdiff_t>(row) * n;
    const auto at = [&](int bytes_per_px) {
      return pixels + static_cast<std::ptrdiff_t>(row) * n * bytes_per_px;
    };
    if (format == PixelFormat::mono8) {
      expose(light, 1, 1);
      quantise(noisy_.data(), 1, n, 1, 255, at(1));
    } else if (format == PixelFormat::mono12) {
      expose(light, 1, 1);
      quantise(noisy_.data(), 1, n, 16, 4095, reinterpret_cast<std::uint16_t*>(at(2)));  // NOLINT
    } else if (format == PixelFormat::rgb8 || format == PixelFormat::bgr8) {
      const float gains[3] = {kBlue, kGreen, kRed};
      for (std::ptrdiff_t channel = 0; channel < 3; ++channel) {
        expose(light, gains[channel], gains[channel]);
        quantise(noisy_.data(), 3, n, 1, 255,
                 at(3) + (format == PixelFormat::bgr8 ? channel : 2 - channel));
      }
    } else {
      float gains[2];
      mosaic_gains(format, row + region.y, gains);
      if ((region.x & 1) != 0) std::swap(gains[0], gains[1]);
      expose(light, gains[0], gains[1]);
      quantise(noisy_.data(), 1, n, 1, 255, at(1));
    }
  }
}

void Scene::render(const SitePose& T_camera_site, const View& view, PixelFormat format,
                   const cv::Rect& region, std::uint8_t* pixels) {
  const auto n = static_cast<std::size_t>(region.area());
  light_.resize(n);
  noisy_.resize(static_cast<std::size_t>(region.width));
  const double f = focal_px();
  const Eigen::Vector2d shift_px = T_camera_site.t_mm.head<2>() * f / parameters_.depth_mm;
  const bool is_translation = T_camera_site.t_mm.z() == 0 && T_camera_site.q.vec().isZero(0);
  if (view.is_dark) {
    std::fill(light_.begin(), light_.end(), kDarkLevel);
  } else if (is_translation) {
    translated_rows(shift_px, region);
  } else {
    // A point of the plane n . X = depth, n = (0, 0, 1): image = K (R + t n^T / depth) K^-1
    // keyframe.
    Eigen::Matrix3d K = Eigen::Matrix3d::Identity();
    K(0, 0) = K(1, 1) = f;
    K.topRightCorner<2, 1>() = principal_point_px();
    Eigen::Matrix3d motion = T_camera_site.q.toRotationMatrix();
    motion.col(2) += T_camera_site.t_mm / parameters_.depth_mm;
    Eigen::Matrix3d margin = Eigen::Matrix3d::Identity();
    margin(0, 2) = margin(1, 2) = margin_px_;
    homography_rows(margin * (K * motion * K.inverse()).inverse(), region);
  }
  if (!view.is_dark) add_glints(shift_px, region);
  if (!view.is_dark && view.is_occluded) occlude(region);
  write(view, format, region, pixels);
}

}  // namespace holdfast::sim
