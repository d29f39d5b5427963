// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/scene.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include <Eigen/LU>
#include <fmt/core.h>
#include <immintrin.h>
#include <opencv2/imgproc.hpp>

#include "bridge/pixel_conversion.hpp"
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

// The same weights, evaluated as four polynomials side by side.
inline __m128 spline_lanes(float f) {
  const __m128 c0 = _mm_setr_ps(1.0F / 6, 4.0F / 6, 1.0F / 6, 0);
  const __m128 c1 = _mm_setr_ps(-0.5F, 0, 0.5F, 0);
  const __m128 c2 = _mm_setr_ps(0.5F, -1, 0.5F, 0);
  const __m128 c3 = _mm_setr_ps(-1.0F / 6, 0.5F, -0.5F, 1.0F / 6);
  const __m128 t = _mm_set1_ps(f);
  __m128 w = _mm_add_ps(c2, _mm_mul_ps(t, c3));
  w = _mm_add_ps(c1, _mm_mul_ps(t, w));
  return _mm_add_ps(c0, _mm_mul_ps(t, w));
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
  for (int i = 0; i < parameters.width_px; ++i) alternating_.push_back(i % 2 == 0 ? 1.0F : -1.0F);
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
void Scene::begin_translation(const Eigen::Vector2d& shift_px, const cv::Rect& region) {
  const double x = region.x - shift_px.x() + margin_px_, y = region.y - shift_px.y() + margin_px_;
  x0_ = static_cast<int>(std::floor(x));
  y0_ = static_cast<int>(std::floor(y));
  spline_weights(x - x0_, wx_);
  spline_weights(y - y0_, wy_);
  ring_.resize(static_cast<std::size_t>(region.width) * 4);
  for (int row = -1; row <= 1; ++row)
    filter_row(y0_ + row, x0_, region.width, wx_, ring_row(row, region.width));
}

void Scene::translated_row(int row, int n) {
  filter_row(y0_ + row + 2, x0_, n, wx_, ring_row(row + 2, n));
  const float *r0 = ring_row(row - 1, n), *r1 = ring_row(row, n), *r2 = ring_row(row + 1, n),
              *r3 = ring_row(row + 2, n);
  const float a = wy_[0], b = wy_[1], c = wy_[2], d = wy_[3];
  float* out = light_.data();
  for (int i = 0; i < n; ++i) out[i] = a * r0[i] + b * r1[i] + c * r2[i] + d * r3[i];
}

float* Scene::ring_row(int row, int n) noexcept {
  return ring_.data() + static_cast<std::ptrdiff_t>(row & 3) * n;
}

// Any rigid pose: each pixel's own sixteen coefficients. Four lanes: first down the four columns,
// then across.
void Scene::homography_row(const Eigen::Matrix3d& texture_of_image, int row,
                           const cv::Rect& region) {
  const Eigen::Vector3d step = texture_of_image.col(0);
  const Eigen::Vector3d start = texture_of_image * Eigen::Vector3d(region.x, region.y + row, 1);
  for (int column = 0; column < region.width; ++column) {
    const double scale = 1 / (start.z() + column * step.z());
    const double x = std::clamp((start.x() + column * step.x()) * scale, 2.0, texture_width_ - 4.0);
    const double y =
        std::clamp((start.y() + column * step.y()) * scale, 2.0, texture_height_ - 4.0);
    const int x0 = static_cast<int>(x), y0 = static_cast<int>(y);
    const __m128 wy = spline_lanes(static_cast<float>(y - y0));
    const float* r0 = texture_row(y0 - 1) + x0 - 1;
    const float *r1 = r0 + texture_width_, *r2 = r1 + texture_width_, *r3 = r2 + texture_width_;
    const __m128 upper = _mm_add_ps(_mm_mul_ps(_mm_shuffle_ps(wy, wy, 0x00), _mm_loadu_ps(r0)),
                                    _mm_mul_ps(_mm_shuffle_ps(wy, wy, 0x55), _mm_loadu_ps(r1)));
    const __m128 lower = _mm_add_ps(_mm_mul_ps(_mm_shuffle_ps(wy, wy, 0xAA), _mm_loadu_ps(r2)),
                                    _mm_mul_ps(_mm_shuffle_ps(wy, wy, 0xFF), _mm_loadu_ps(r3)));
    const __m128 wx = spline_lanes(static_cast<float>(x - x0));
    light_[static_cast<std::size_t>(column)] =
        _mm_cvtss_f32(_mm_dp_ps(_mm_add_ps(upper, lower), wx, 0xF1));
  }
}

void Scene::add_glints(const Eigen::Vector2d& shift_px, int row, const cv::Rect& region) {
  for (const Glint& glint : glints_) {
    const double x = glint.x_px + 0.5 * shift_px.x() - region.x;
    const double dy = row - (glint.y_px + 0.5 * shift_px.y() - region.y);
    const double reach = 3 * glint.radius_px;
    if (std::abs(dy) > reach) continue;
    const int begin = std::max(0, static_cast<int>(x - reach));
    const int end = std::min(region.width, static_cast<int>(x + reach));
    for (int column = begin; column < end; ++column) {
      const double d2 = (column - x) * (column - x) + dy * dy;
      light_[static_cast<std::size_t>(column)] +=
          static_cast<float>(400 * std::exp(-2 * d2 / (glint.radius_px * glint.radius_px)));
    }
  }
}

void Scene::occlude(int row, const cv::Rect& region) {
  const float* glove = occluder_.data() +
                       static_cast<std::ptrdiff_t>(row + region.y) * parameters_.width_px +
                       region.x;
  float* out = light_.data();
  for (int i = 0; i < region.width; ++i) out[i] = glove[i] >= 0 ? glove[i] : out[i];
}

namespace {

template <typename Sample>
void quantise(const float* from, int n, float scale, float highest, Sample* out) {
  for (int i = 0; i < n; ++i) {
    const float value = from[i] * scale + 0.5F;
    const float positive = value > 0 ? value : 0;
    const float bounded = positive < highest ? positive : highest;
    out[i] = static_cast<Sample>(static_cast<int>(bounded));
  }
}

// What the pixels of a mosaic's row see, in the order of the sensor's columns.
std::pair<float, float> mosaic_gains(PixelFormat format, int row) {
  const bool odd = (row & 1) != 0;
  switch (format) {
    case PixelFormat::bayer_rg8:
      return odd ? std::pair{kGreen, kBlue} : std::pair{kRed, kGreen};
    case PixelFormat::bayer_gb8:
      return odd ? std::pair{kRed, kGreen} : std::pair{kGreen, kBlue};
    case PixelFormat::bayer_gr8:
      return odd ? std::pair{kBlue, kGreen} : std::pair{kGreen, kRed};
    case PixelFormat::bayer_bg8:
      return odd ? std::pair{kGreen, kRed} : std::pair{kBlue, kGreen};
    default:
      return {1, 1};
  }
}

}  // namespace

// One row of light through a filter, with noise, into `noisy_`.
void Scene::expose_row(const float* light, std::pair<float, float> gains, bool has_noise, int n) {
  const auto read2 = static_cast<float>(parameters_.read_noise_dn * parameters_.read_noise_dn);
  const auto shot2 = static_cast<float>(parameters_.shot_noise_dn * parameters_.shot_noise_dn);
  const float* noise = noise_.data() + random_() % (kNoiseSize - static_cast<std::size_t>(n));
  const float amount = has_noise ? 1.0F : 0.0F;
  const float mean = (gains.first + gains.second) / 2, half = (gains.first - gains.second) / 2;
  float* out = noisy_.data();
  const float* sign = alternating_.data();  // +1, -1, +1...
  for (int i = 0; i < n; ++i) {
    const float value = light[i] * (mean + sign[i] * half);
    out[i] = value + amount * std::sqrt(read2 + shot2 * value) * noise[i];
  }
}

void Scene::write_colour_row(const float* light, bool has_noise, int n, bool is_bgr,
                             std::uint8_t* out) {
  const float gains[3] = {is_bgr ? kBlue : kRed, kGreen, is_bgr ? kRed : kBlue};
  cv::Mat planes[3];
  for (std::size_t channel = 0; channel < 3; ++channel) {
    std::uint8_t* plane = planes_.data() + channel * static_cast<std::size_t>(n);
    expose_row(light, {gains[channel], gains[channel]}, has_noise, n);
    quantise(noisy_.data(), n, 1, 255, plane);
    planes[channel] = cv::Mat(1, n, CV_8UC1, plane);
  }
  cv::Mat merged(1, n, CV_8UC3, out);
  cv::merge(planes, 3, merged);
}

void Scene::write_row(const View& view, PixelFormat format, int row, const cv::Rect& region,
                      std::uint8_t* out) {
  const int n = region.width;
  if (format == PixelFormat::rgb8 || format == PixelFormat::bgr8) {
    write_colour_row(light_.data(), view.has_noise, n, format == PixelFormat::bgr8, out);
    return;
  }
  auto gains = mosaic_gains(format, row + region.y);
  if ((region.x & 1) != 0) std::swap(gains.first, gains.second);
  expose_row(light_.data(), gains, view.has_noise, n);
  if (format == PixelFormat::mono12)
    quantise(noisy_.data(), n, 16, 4095, reinterpret_cast<std::uint16_t*>(out));  // NOLINT
  else
    quantise(noisy_.data(), n, 1, 255, out);
}

// A point of the plane n . X = depth, n = (0, 0, 1): image = K (R + t n^T / depth) K^-1 keyframe.
Eigen::Matrix3d Scene::texture_from_image(const SitePose& T_camera_site) const {
  Eigen::Matrix3d K = Eigen::Matrix3d::Identity();
  K(0, 0) = K(1, 1) = focal_px();
  K.topRightCorner<2, 1>() = principal_point_px();
  Eigen::Matrix3d motion = T_camera_site.q.toRotationMatrix();
  motion.col(2) += T_camera_site.t_mm / parameters_.depth_mm;
  Eigen::Matrix3d margin = Eigen::Matrix3d::Identity();
  margin(0, 2) = margin(1, 2) = margin_px_;
  return margin * (K * motion * K.inverse()).inverse();
}

void Scene::render(const SitePose& T_camera_site, const View& view, PixelFormat format,
                   const cv::Rect& region, std::uint8_t* pixels) {
  const auto n = static_cast<std::size_t>(region.width);
  light_.resize(n);
  noisy_.resize(n);
  planes_.resize(3 * n);
  const Eigen::Vector2d shift_px = T_camera_site.t_mm.head<2>() * focal_px() / parameters_.depth_mm;
  const bool is_translation = T_camera_site.t_mm.z() == 0 && T_camera_site.q.vec().isZero(0);
  const Eigen::Matrix3d texture_of_image = texture_from_image(T_camera_site);
  if (is_translation) begin_translation(shift_px, region);
  const std::size_t stride = bridge::row_bytes(format, region.width);
  for (int row = 0; row < region.height; ++row) {
    if (view.is_dark)
      std::fill(light_.begin(), light_.end(), kDarkLevel);
    else if (is_translation)
      translated_row(row, region.width);
    else
      homography_row(texture_of_image, row, region);
    if (!view.is_dark) add_glints(shift_px, row, region);
    if (!view.is_dark && view.is_occluded) occlude(row, region);
    write_row(view, format, row, region, pixels + static_cast<std::size_t>(row) * stride);
  }
}

}  // namespace holdfast::sim
