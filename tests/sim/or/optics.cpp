// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/optics.hpp"

#include <cmath>
#include <limits>
#include <numbers>

#include <fmt/format.h>

#include "rt/core/error.hpp"
#include "tests/sim/or/seeded_random.hpp"

namespace holdfast::sim {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

class Random {
 public:
  explicit Random(std::uint32_t seed, std::uint32_t stream = 0)
      : random_{seed, stream, 0x0971c5U} {}
  /// Uniform in -1..1.
  double operator()() { return random_.between(-1, 1); }
  double normal() { return (*this)() + (*this)() + (*this)(); }  // variance 1, within +-3
  Vector2d direction() {
    const double angle = std::numbers::pi * (*this)();
    return {std::cos(angle), std::sin(angle)};
  }

 private:
  SeededRandom random_;
};

double value(const std::array<double, 4>& curve, double t) {
  return curve[0] + t * (curve[1] + t * (curve[2] + t * curve[3]));
}

Eigen::Isometry3d pose(const Vector3d& position, double yaw, double pitch, double roll) {
  Eigen::Isometry3d T_head_camera = Eigen::Isometry3d::Identity();
  T_head_camera.translate(position);
  T_head_camera.rotate(Eigen::AngleAxisd(yaw, Vector3d::UnitY()));
  T_head_camera.rotate(Eigen::AngleAxisd(pitch, Vector3d::UnitX()));
  T_head_camera.rotate(Eigen::AngleAxisd(roll, Vector3d::UnitZ()));
  return T_head_camera;
}

}  // namespace

Vector2d OpticalChannel::distort(const Vector2d& m) const {
  const double x = m.x(), y = m.y(), r2 = m.squaredNorm();
  const double radial = 1 + r2 * (k1_ + r2 * (k2_ + r2 * (k3_ + r2 * k4_)));
  Vector2d d{x * radial + 2 * p1_ * x * y + p2_ * (r2 + 2 * x * x) + s1_ * r2,
             y * radial + p1_ * (r2 + 2 * y * y) + 2 * p2_ * x * y + s2_ * r2};
  for (const Ripple& ripple : ripples_)
    d += ripple.amplitude * std::sin(ripple.wave.dot(m) + ripple.phase);
  return d;
}

Vector2d OpticalChannel::project(const Vector3d& p) const {
  // The pupil of this line of sight depends on its slope, which depends on the pupil: a fixed
  // point whose contraction is about 1e-3.
  double z = p.z();
  for (int i = 0; i < 6; ++i)
    z = p.z() - pupil_shift_mm_ * (p.x() * p.x() + p.y() * p.y()) / (z * z);
  if (!(p.z() > 0 && z > 0)) return Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
  const Vector2d d = distort(p.head<2>() / z);
  return {fx_ * d.x() + cx_, fy_ * d.y() + cy_};
}

SightLine OpticalChannel::sight_line(const Vector2d& pixel) const {
  const Vector2d wanted{(pixel.x() - cx_) / fx_, (pixel.y() - cy_) / fy_};
  Vector2d m = wanted;
  double error = 1;
  for (int i = 0; i < 20 && error > 1e-14; ++i) {
    const double h = 1e-6;
    const Vector2d residual = distort(m) - wanted;
    Eigen::Matrix2d J;
    J.col(0) = (distort(m + Vector2d(h, 0)) - distort(m - Vector2d(h, 0))) / (2 * h);
    J.col(1) = (distort(m + Vector2d(0, h)) - distort(m - Vector2d(0, h))) / (2 * h);
    m -= J.inverse() * residual;
    error = residual.norm();
  }
  if (!(error < 1e-12)) m.setConstant(std::numeric_limits<double>::quiet_NaN());
  return {{0, 0, pupil_shift_mm_ * m.squaredNorm()}, {m.x(), m.y(), 1}};
}

template <typename R>
void Microscope::draw(ChannelDesign& d, double side, R& random) const {
  const double odd = parameters_.irregularity;
  const double f = 4020 * (1 + 0.004 * random());
  d.f = {f, f * 0.2 / 1.3 * (1 + 0.01 * random()), f * 2e-3 * random(), f * 4e-4 * random()};
  d.aspect = {1 + 2e-4 * random(), 2e-5 * random(), 0, 0};
  d.cx = {0.5 * (kSensorWidthPx - 1) + 12 * random(), 3 * random(), 1 * random(), 0.2 * random()};
  d.cy = {0.5 * (kSensorHeightPx - 1) + 12 * random(), 3 * random(), 1 * random(), 0.2 * random()};
  d.k1 = {-0.06 + 0.02 * random(), 0.015 * random(), 0.003 * random(), 0.0005 * random()};
  d.k2 = {0.06 + 0.03 * random(), 0.02 * random(), 0.004 * random(), 0};
  d.k3 = {-0.04 + 0.03 * random(), 0.01 * random(), 0, 0};
  d.p1 = {4e-4 * random(), 1e-4 * random(), 2e-5 * random(), 0};
  d.p2 = {4e-4 * random(), 1e-4 * random(), 2e-5 * random(), 0};
  d.k4 = {odd * (0.08 + 0.04 * random()), odd * 0.02 * random(), 0, 0};
  d.s1 = {odd * 2e-4 * random(), odd * 3e-5 * random(), 0, 0};
  d.s2 = {odd * 2e-4 * random(), odd * 3e-5 * random(), 0, 0};
  d.pupil_shift = {odd * (1.2 + 0.5 * random()), odd * 0.2 * random(), 0, 0};
  for (auto& ripple : d.ripples) {
    ripple.amplitude = odd * 0.03 * random.direction();
    const double wave = 12 + 6 * random();
    ripple.wave = wave * random.direction();
    ripple.phase = std::numbers::pi * random();
  }
  // Toe-in: both axes meet near the focal plane.
  const double toe_in = std::atan2(0.5 * base_mm_, focus_mm_);
  d.yaw = {-side * toe_in + 2e-3 * random(), 2e-4 * random(), 1e-4 * random(), 0};
  d.pitch = {1.5e-3 * random(), 2e-4 * random(), 1e-4 * random(), 0};
  d.roll = {2.5e-3 * random(), 1e-4 * random(), 0, 0};
  d.x = {side * 0.5 * base_mm_, 0.02 * random(), 0.01 * random(), 0};
  d.y = {0.15 * random(), 0.02 * random(), 0, 0};
  d.z = {0.3 * random(), 0.2 * random(), 0.03 * random(), 0};
  d.gain = 1 + side * parameters_.exposure_mismatch * (0.6 + 0.4 * random());
}

Microscope::Microscope(const OpticsParameters& parameters) : parameters_(parameters) {
  Random random{parameters.seed};
  focus_mm_ = 200 + 1.5 * random();
  base_mm_ = 24 + 0.5 * random();
  draw(left_, -1, random);
  draw(right_, 1, random);
}

OpticalChannel Microscope::channel(const ChannelDesign& d, double t, double zoom,
                                   const Vector3d& seating) const {
  OpticalChannel c;
  c.fx_ = value(d.f, t) * (1 + seating.z());
  c.fy_ = c.fx_ * value(d.aspect, t);
  c.cx_ = value(d.cx, t) + seating.x();
  c.cy_ = value(d.cy, t) + seating.y();
  c.k1_ = value(d.k1, t);
  c.k2_ = value(d.k2, t);
  c.k3_ = value(d.k3, t);
  c.k4_ = value(d.k4, t);
  c.p1_ = value(d.p1, t);
  c.p2_ = value(d.p2, t);
  c.s1_ = value(d.s1, t);
  c.s2_ = value(d.s2, t);
  c.pupil_shift_mm_ = value(d.pupil_shift, t);
  c.ripples_ = d.ripples;
  for (auto& ripple : c.ripples_) {
    ripple.amplitude /= c.fx_;
    ripple.wave *= zoom / 1.3;  // fixed on the sensor side
  }
  c.gain_ = d.gain;
  return c;
}

StereoOptics Microscope::at(double zoom, std::uint32_t visit) const {
  if (!(zoom >= kZoomMin && zoom <= kZoomMax))
    throw InputError(fmt::format("zoom = {} is out of range {} to {}", zoom, kZoomMin, kZoomMax));
  const double t = (zoom - 1.3) / 0.2;
  std::array<Vector3d, 2> seating{Vector3d::Zero(), Vector3d::Zero()};
  if (visit != 0) {
    Random random{parameters_.seed, visit};
    const double focal = parameters_.seating_focal * random.normal();
    for (Vector3d& s : seating)
      s = {parameters_.seating_px * random.normal(), parameters_.seating_px * random.normal(),
           focal};
  }
  const auto T_head = [t](const ChannelDesign& d) {
    return pose({value(d.x, t), value(d.y, t), value(d.z, t)}, value(d.yaw, t), value(d.pitch, t),
                value(d.roll, t));
  };
  StereoOptics optics;
  optics.zoom = zoom;
  optics.focus_mm = focus_mm_;
  optics.left = channel(left_, t, zoom, seating[0]);
  optics.right = channel(right_, t, zoom, seating[1]);
  optics.T_head_left = T_head(left_);
  optics.T_head_right = T_head(right_);
  optics.aperture_mm = parameters_.aperture_mm;
  optics.blur_px = parameters_.blur_px;
  return optics;
}

}  // namespace holdfast::sim
