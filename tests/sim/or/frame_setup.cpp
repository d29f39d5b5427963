// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/frame_setup.hpp"

#include <cmath>
#include <numbers>

#include <opencv2/imgproc.hpp>
#include <tbb/parallel_for.h>

namespace holdfast::sim {
namespace {

using Eigen::Vector3d;

kernel::Vec3 as_kernel(const Vector3d& v) {
  return {static_cast<float>(v.x()), static_cast<float>(v.y()), static_cast<float>(v.z())};
}

// A disc of `diameter` facing `target`; its points spread so that any 4x4 pixels share them out.
kernel::Source source(const Vector3d& position, const Vector3d& target, double diameter,
                      double power) {
  kernel::Source s{};
  s.position = as_kernel(position);
  s.power = static_cast<float>(power);
  s.reference_mm = static_cast<float>((target - position).norm());
  s.is_on = power > 0;
  const Vector3d axis = (target - position).normalized();
  const Vector3d u = axis.unitOrthogonal(), v = axis.cross(u);
  const double golden = std::numbers::pi * (3 - std::sqrt(5.0));
  for (int i = 0; i < kernel::kLanes; ++i) {
    const double r = 0.5 * diameter * std::sqrt((i + 0.5) / kernel::kLanes);
    s.disc[(7 * i) % kernel::kLanes] =
        as_kernel(r * (std::cos(golden * i) * u + std::sin(golden * i) * v));
  }
  return s;
}

}  // namespace

double ProjectedPattern::variance(std::size_t level) const noexcept {
  const double own = kScale * blur_px_ * kScale * blur_px_;
  return level == 0 ? own : level == 1 ? 4 * own : 16 * own;
}

void ProjectedPattern::prepare(const cv::Mat& pattern, double blur_px) {
  if (blur_px == blur_px_ && pattern.size() == pattern_.size() && !pattern_.empty() &&
      cv::norm(pattern, pattern_, cv::NORM_INF) == 0)
    return;
  pattern_ = pattern.clone();
  blur_px_ = blur_px;
  cv::Mat_<float> image;
  pattern.convertTo(image, CV_32F, 1.0 / 255);
  const cv::Size size(kScale * kProjectorWidthPx, kScale * kProjectorHeightPx);
  if (image.cols < size.width)
    cv::resize(image, image, size, 0, 0, cv::INTER_NEAREST);  // the mirrors are squares
  else
    cv::resize(image, image, size, 0, 0, cv::INTER_AREA);
  double done = 0;
  for (std::size_t level = 0; level < levels_.size(); ++level) {
    const double sigma = std::sqrt(variance(level) - done);
    cv::GaussianBlur(level == 0 ? image : levels_[level - 1], levels_[level], {}, sigma, sigma,
                     cv::BORDER_CONSTANT);
    done = variance(level);
  }
}

Eigen::Vector2d FrameSetup::slopes_at(double x, double y) const {
  const kernel::SightGrid& grid = frame_.sight;
  const double gx = std::clamp((x - grid.x0_px) / grid.step_px, 0.0, grid.columns - 1.001);
  const double gy = std::clamp((y - grid.y0_px) / grid.step_px, 0.0, grid.rows - 1.001);
  const int ix = static_cast<int>(gx), iy = static_cast<int>(gy);
  const double fx = gx - ix, fy = gy - iy;
  const float* a = grid.slopes + 3 * (iy * grid.columns + ix);
  const float* b = a + 3 * grid.columns;
  const auto mix = [&](int i) {
    return (1 - fy) * ((1 - fx) * static_cast<double>(a[i]) + fx * static_cast<double>(a[i + 3])) +
           fy * ((1 - fx) * static_cast<double>(b[i]) + fx * static_cast<double>(b[i + 3]));
  };
  return {mix(0), mix(1)};
}

void FrameSetup::prepare(const RoomShot& shot, Side side, const LitScene& scene,
                         ProjectedPattern& pattern) {
  frame_.scene = scene.scene();
  frame_.surfaces = scene.kernel_surfaces().data();
  frame_.table = scene.table();
  prepare_camera(shot, side);
  prepare_lights(shot, pattern);
}

void FrameSetup::prepare_camera(const RoomShot& shot, Side side) {
  const bool is_left = side == Side::left;
  channel_ = is_left ? &shot.optics.left : &shot.optics.right;
  const Eigen::Isometry3d& T_head_camera =
      is_left ? shot.optics.T_head_left : shot.optics.T_head_right;
  const Eigen::Isometry3d T_ct_camera = shot.T_ct_head * T_head_camera;
  frame_.pupil = as_kernel(T_ct_camera.translation());
  frame_.axis_x = as_kernel(T_ct_camera.linear().col(0));
  frame_.axis_y = as_kernel(T_ct_camera.linear().col(1));
  frame_.axis_z = as_kernel(T_ct_camera.linear().col(2));
  // The plane z = focus of the head, as n.p = d in the camera's frame: 1/depth = n.m / d.
  const Vector3d n = T_head_camera.linear().row(2);
  inverse_focus_ = n / (shot.optics.focus_mm - T_head_camera.translation().z());

  // Bilinear over 8 px errs by less than 4e-4 px at this distortion.
  kernel::SightGrid& grid = frame_.sight;
  grid.step_px = 8;
  grid.x0_px = shot.region.x - grid.step_px;
  grid.y0_px = shot.region.y - grid.step_px;
  grid.columns = shot.region.width / grid.step_px + 4;
  grid.rows = shot.region.height / grid.step_px + 4;
  slopes_.resize(3 * static_cast<std::size_t>(grid.columns) * static_cast<std::size_t>(grid.rows));
  grid.slopes = slopes_.data();
  tbb::parallel_for(0, grid.rows, [&](int row) {
    for (int column = 0; column < grid.columns; ++column) {
      const SightLine line = channel_->sight_line(
          {grid.x0_px + grid.step_px * column, grid.y0_px + grid.step_px * row});
      float* out =
          &slopes_[3 * (static_cast<std::size_t>(row) * static_cast<std::size_t>(grid.columns) +
                        static_cast<std::size_t>(column))];
      out[0] = static_cast<float>(line.direction.x());
      out[1] = static_cast<float>(line.direction.y());
      out[2] = static_cast<float>(line.origin_mm.z());
    }
  });
}

void FrameSetup::prepare_lights(const RoomShot& shot, ProjectedPattern& pattern) {
  const Lights& lights = shot.lights;
  const Vector3d target = shot.T_ct_head * Vector3d(0, 0, shot.optics.focus_mm);
  frame_.or_light = static_cast<float>(lights.or_light);
  frame_.microscope_light =
      source(shot.T_ct_head * Vector3d(0, -9, 2), target, 8, lights.microscope_light);
  kernel::Projector& p = frame_.projector;
  p = {};
  if (lights.pattern.empty() || !(lights.pattern_power > 0)) return;
  const ProjectorOptics& optics = shot.projector;
  pattern.prepare(lights.pattern, optics.blur_px);
  constexpr double kScale = ProjectedPattern::kScale;
  p.source =
      source(shot.T_ct_head * optics.p_head_mm, target, optics.aperture_mm, lights.pattern_power);
  const Eigen::Matrix3d axes = shot.T_ct_head.linear() * optics.R_head_projector;
  p.axis_x = as_kernel(axes.col(0));
  p.axis_y = as_kernel(axes.col(1));
  p.axis_z = as_kernel(axes.col(2));
  p.focal = static_cast<float>(kScale * optics.focal_px);
  p.cx = static_cast<float>(kScale * (optics.cx_px + 0.5) - 0.5);
  p.cy = static_cast<float>(kScale * (optics.cy_px + 0.5) - 0.5);
  p.k1 = static_cast<float>(optics.k1);
  for (std::size_t i = 0; i < pattern.levels().size(); ++i) {
    const cv::Mat_<float>& level = pattern.levels()[i];
    p.levels[i] = {level.ptr<float>(), level.cols, level.rows};
    p.level_variance[i] = static_cast<float>(pattern.variance(i));
  }
  p.base_variance = p.level_variance[0];
  // A disc's standard deviation along an axis is a quarter of its diameter.
  p.defocus = static_cast<float>(0.25 * optics.aperture_mm * kScale * optics.focal_px);
  p.inverse_focus = static_cast<float>(1 / optics.focus_mm);
}

}  // namespace holdfast::sim
