// SPDX-License-Identifier: Apache-2.0
#include "perception/patch_alignment.hpp"

#include <array>
#include <cmath>

namespace holdfast::perception {
namespace {

constexpr int kRadius = 4, kSide = 2 * kRadius + 1, kCount = kSide * kSide;
constexpr int kIterations = 10;
constexpr double kSettledPx = 0.01;           // of the last step; what is left is a tenth of it
constexpr float kTextureMin = 4.0F * kCount;  // sum of squared grey levels: 2 grey levels rms

using Patch = std::array<float, kCount>;

/// Subtracts the mean; returns the sum of squares left.
float centre_values(Patch& patch) {
  float sum = 0, squares = 0;
  for (const float v : patch) sum += v;
  const float mean = sum / kCount;
  for (float& v : patch) {
    v -= mean;
    squares += v * v;
  }
  return squares;
}

float dot(const Patch& a, const Patch& b) {
  float sum = 0;
  for (std::size_t i = 0; i < kCount; ++i) sum += a[i] * b[i];
  return sum;
}

struct Template {
  Patch values, gx, gy;
  float squares = 0;
  float hxx = 0, hxy = 0, hyy = 0;
};

bool make_template(const cv::Mat& image, cv::Point centre, Template& out) {
  if (centre.x <= kRadius || centre.y <= kRadius || centre.x + kRadius + 1 >= image.cols ||
      centre.y + kRadius + 1 >= image.rows)
    return false;
  const auto step = static_cast<std::ptrdiff_t>(image.step1());
  std::size_t k = 0;
  for (int y = -kRadius; y <= kRadius; ++y) {
    const uchar* row = image.ptr(centre.y + y) + centre.x;
    for (int x = -kRadius; x <= kRadius; ++x, ++k) {
      out.values[k] = row[x];
      out.gx[k] = 0.5F * static_cast<float>(row[x + 1] - row[x - 1]);
      out.gy[k] = 0.5F * static_cast<float>(row[x + step] - row[x - step]);
    }
  }
  out.squares = centre_values(out.values);
  centre_values(out.gx);  // the mean is free: what it explains is not motion
  centre_values(out.gy);
  out.hxx = dot(out.gx, out.gx);
  out.hxy = dot(out.gx, out.gy);
  out.hyy = dot(out.gy, out.gy);
  const float trace = out.hxx + out.hyy, determinant = out.hxx * out.hyy - out.hxy * out.hxy;
  // The weaker direction must be seen as well: a patch on an edge slides along it.
  return out.squares > kTextureMin && determinant > 0.02F * trace * trace;
}

/// Samples the target bilinearly at p + warp * offset, on the template's grid.
bool sample(const cv::Mat& image, cv::Point2d p, const cv::Matx22d& warp, Patch& out) {
  const double reach_x = kRadius * (std::abs(warp(0, 0)) + std::abs(warp(0, 1)));
  const double reach_y = kRadius * (std::abs(warp(1, 0)) + std::abs(warp(1, 1)));
  if (!(p.x - reach_x >= 0 && p.y - reach_y >= 0 && p.x + reach_x < image.cols - 1 &&
        p.y + reach_y < image.rows - 1))
    return false;
  const auto step = static_cast<std::ptrdiff_t>(image.step1());
  const uchar* data = image.ptr();
  const auto ax = static_cast<float>(warp(0, 0)), ay = static_cast<float>(warp(1, 0));
  std::size_t k = 0;
  for (int y = -kRadius; y <= kRadius; ++y) {
    const auto x0 = static_cast<float>(p.x + warp(0, 1) * y - warp(0, 0) * kRadius);
    const auto y0 = static_cast<float>(p.y + warp(1, 1) * y - warp(1, 0) * kRadius);
    for (int i = 0; i < kSide; ++i, ++k) {
      const float u = x0 + ax * static_cast<float>(i), v = y0 + ay * static_cast<float>(i);
      const int iu = static_cast<int>(u), iv = static_cast<int>(v);
      const float fu = u - static_cast<float>(iu), fv = v - static_cast<float>(iv);
      const uchar* q = data + iv * step + iu;
      const float top = static_cast<float>(q[0]) + fu * static_cast<float>(q[1] - q[0]);
      const float bottom =
          static_cast<float>(q[step]) + fu * static_cast<float>(q[step + 1] - q[step]);
      out[k] = top + fv * (bottom - top);
    }
  }
  return true;
}

}  // namespace

std::optional<AlignedPatch> align_patch(const cv::Mat& source, cv::Point centre,
                                        const cv::Mat& target, cv::Point2d start,
                                        const cv::Matx22d& warp, double reach_px) {
  Template t;
  if (!make_template(source, centre, t)) return std::nullopt;
  const float determinant = t.hxx * t.hyy - t.hxy * t.hxy;
  Patch patch;
  cv::Point2d p = start;
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    if (!sample(target, p, warp, patch)) return std::nullopt;
    const float squares = centre_values(patch);
    if (squares < kTextureMin / 4) return std::nullopt;
    const float correlation = dot(patch, t.values);
    const float gain = std::sqrt(t.squares / squares);
    // J^T (gain * patch - template); the mean is out of all three already.
    const float bx = gain * dot(t.gx, patch) - dot(t.gx, t.values);
    const float by = gain * dot(t.gy, patch) - dot(t.gy, t.values);
    const auto sx = static_cast<double>((t.hyy * bx - t.hxy * by) / determinant);
    const auto sy = static_cast<double>((t.hxx * by - t.hxy * bx) / determinant);
    const cv::Vec2d step = warp * cv::Vec2d(sx, sy);
    p.x -= step[0];
    p.y -= step[1];
    if (!(std::hypot(p.x - start.x, p.y - start.y) <= reach_px)) return std::nullopt;
    if (std::hypot(step[0], step[1]) < kSettledPx)
      return AlignedPatch{p, static_cast<double>(correlation / std::sqrt(t.squares * squares))};
  }
  return std::nullopt;
}

}  // namespace holdfast::perception
