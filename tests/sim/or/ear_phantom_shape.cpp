// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/ear_phantom_shape.hpp"

#include <cmath>
#include <numbers>

#include "tests/sim/or/phantom_random.hpp"

namespace holdfast::sim {
namespace {

using Eigen::Vector2f;
using Eigen::Vector3f;

constexpr float kSheetHalfThickness = 1.6F;
constexpr float kGrooveFrom = 20.F, kGrooveTo = 150.F;  // along the outline, degrees from +x
constexpr float kSquare = 1.1F;                         // 0: an ellipse

}  // namespace

EarShape::Proportions EarShape::draw(std::uint32_t seed) {
  PhantomRandom random(0xea500000ULL + seed);
  const auto vary = [&random](double middle, double by) {
    return static_cast<float>(random.uniform(middle - by, middle + by));
  };
  Proportions s{};
  s.half_width = vary(20.0, 1.0);
  s.half_length = vary(44.0, 1.5);
  s.egg = vary(0.20, 0.05);
  s.lean = vary(0.0, 0.04);
  s.bowl_depth = vary(1.0, 0.1);
  s.rim_radius = vary(3.5, 0.25);
  s.relief = vary(1.0, 0.15);
  s.wave_sin = vary(0.0, 0.025);
  s.wave_cos = vary(0.0, 0.025);
  return s;
}

EarShape::EarShape(std::uint32_t seed)
    : shape_(draw(seed)),
      rim_(make_rim(shape_.rim_radius - 0.2F, 3.F, shape_.rim_radius, -35.F, 195.F)),
      groove_(make_rim(shape_.rim_radius + 2.9F, 1.7F, 2.4F, kGrooveFrom, kGrooveTo)),
      crus_({rim_node(195.F, shape_.rim_radius - 0.2F, 2.6F, 3.1F),
             {{-15.5F, 3.F, 10.F}, 2.7F},
             {{-10.F, 1.5F, 6.5F}, 2.3F},
             {{-3.F, 2.5F, 2.5F}, 1.6F},
             {{4.F, 4.5F, 1.F}, 0.8F}}),
      ridges_(make_ridges()),
      lobule_(node(-1.5F, -33.5F, 0.3F, 0.F).p),
      canal_({{{-9.F, -7.F, 5.F}, 3.4F},
              {{-12.5F, -7.F, 1.5F}, 3.2F},
              {{-16.5F, -6.F, -0.5F}, 2.4F}}) {
  for (float angle = kGrooveFrom + 12.F; angle < kGrooveTo - 12.F; angle += 2.F)
    overhang_.push_back(rim_node(angle, shape_.rim_radius + 1.6F, 1.6F, 0.F).p);
}

Eigen::AlignedBox3f EarShape::bounds() {
  return {Vector3f(-28, -50, -4), Vector3f(31, 50, 28)};
}

// An egg, wider at the top, squarer than an ellipse and leaning a little; `inset` across it.
Vector2f EarShape::outline(float angle_rad, float inset_mm) const {
  const float c = std::cos(angle_rad);
  const float s = std::sin(angle_rad);
  const float out = 1.F / std::sqrt(std::sqrt(1.F - kSquare * c * c * s * s));
  const float y = (shape_.half_length - inset_mm) * s * out;
  const float width =
      (shape_.half_width * wave(c, s) - inset_mm) * (1.F + shape_.egg * y / shape_.half_length);
  return {width * c * out + shape_.lean * y, y};
}

float EarShape::wave(float c, float s) const noexcept {
  const float sin3 = s * (3.F - 4.F * s * s);
  const float cos3 = c * (4.F * c * c - 3.F);
  return 1.F + shape_.wave_sin * sin3 + shape_.wave_cos * cos3;
}

float EarShape::outline_distance(float x, float y) const noexcept {
  const float v = y / shape_.half_length;
  const float width = shape_.half_width * (1.F + shape_.egg * std::clamp(v, -1.2F, 1.2F));
  float u = (x - shape_.lean * y) / width;
  const float r = std::sqrt(u * u + v * v) + 1e-3F;
  u /= wave(u / r, v / r);
  const float sum = u * u + v * v;
  const float q = std::sqrt(std::sqrt(sum * sum - kSquare * u * u * v * v)) + 1e-3F;
  const float slope_u = u / width;
  const float slope_v = v / shape_.half_length;
  return (q - 1.F) * q / std::sqrt(slope_u * slope_u + slope_v * slope_v + 1e-6F);
}

// The middle of the auricle's sheet: rises towards the back, cupped at the top, sinks to the
// lobule.
float EarShape::sheet_height(float x, float y) const noexcept {
  const float rise = 0.27F * (x + 18.F);
  const float cup = y > 0.F ? 0.0016F * y * y : -0.0012F * y * y;
  const float lobe = std::exp(-0.006F * (x * x + (y + 36.F) * (y + 36.F)));
  return 4.5F + rise + cup - 1.5F * lobe;
}

float EarShape::sheet(const Vector3f& p) const noexcept {
  const float height = sheet_height(p.x(), p.y());
  const float slope = std::sqrt(0.073F + 1e-5F * p.y() * p.y());
  const float through =
      std::abs(p.z() - height) / std::sqrt(1.F + slope * slope) - kSheetHalfThickness;
  return -blend_union(-through, -outline_distance(p.x(), p.y()), 3.F);
}

Tube::Node EarShape::node(float x, float y, float above_mm, float radius_mm) const {
  const float sx = x * shape_.half_width / 20.F + shape_.lean * y;
  const float sy = y * shape_.half_length / 44.F;
  return {{sx, sy, sheet_height(sx, sy) + above_mm * shape_.relief}, radius_mm};
}

Tube::Node EarShape::rim_node(float angle_deg, float inset_mm, float above_mm,
                              float radius_mm) const {
  const Vector2f at = outline(angle_deg * std::numbers::pi_v<float> / 180.F, inset_mm);
  return {{at.x(), at.y(), sheet_height(at.x(), at.y()) + above_mm}, radius_mm};
}

// Along the outline; thins out and sinks into the sheet at the lower end.
Tube EarShape::make_rim(float inset_mm, float above_mm, float radius_mm, float from_deg,
                        float to_deg) const {
  std::vector<Tube::Node> nodes;
  constexpr int kSpans = 14;
  for (int i = 0; i <= kSpans; ++i) {
    const float s = static_cast<float>(i) / kSpans;
    const float full = std::min(1.F, std::min(s, 1.F - s) * 5.F);
    const float size = from_deg < 0.F && s > 0.5F ? 1.F : 0.55F + 0.45F * full;
    nodes.push_back(
        rim_node(from_deg + s * (to_deg - from_deg), inset_mm, above_mm * size, radius_mm * size));
  }
  return Tube(nodes, 4);
}

std::vector<Tube> EarShape::make_ridges() const {
  std::vector<Tube> ridges;
  ridges.emplace_back(std::vector{node(6.F, -19.F, 1.F, 3.2F), node(10.F, -8.F, 1.6F, 3.4F),
                                  node(10.5F, 4.F, 2.2F, 3.5F), node(7.F, 15.F, 2.F, 3.3F),
                                  node(3.F, 24.F, 1.2F, 3.F), node(1.F, 32.F, 0.F, 2.4F)});
  ridges.emplace_back(std::vector{node(9.F, 10.F, 1.8F, 3.F), node(3.F, 15.5F, 1.8F, 2.7F),
                                  node(-5.F, 18.F, 1.5F, 2.5F), node(-13.F, 18.F, 0.5F, 2.3F)});
  ridges.emplace_back(std::vector{node(7.F, -17.F, 1.5F, 3.F), node(2.F, -19.F, 3.F, 3.3F),
                                  node(-3.F, -19.F, 2.5F, 2.9F), node(-7.F, -19.5F, 0.F, 2.5F)});
  ridges.emplace_back(std::vector{node(-16.F, 1.F, 3.F, 2.6F), node(-12.5F, -4.F, 6.5F, 2.9F),
                                  node(-11.F, -8.F, 7.F, 3.F), node(-12.F, -12.F, 5.F, 2.7F),
                                  node(-15.F, -16.F, 2.F, 2.6F)});
  return ridges;
}

float EarShape::distance(const Vector3f& p) const noexcept {
  const float stem = ellipsoid(p, {-3.5F, -3.F, -6.F}, {16.5F, 23.F, 17.F});
  float d = blend_union(sheet(p), stem, 3.F);
  d = blend_union(d, ellipsoid(p, lobule_, {10.5F, 10.F, 4.6F}), 5.F);
  d = blend_difference(
      d, ellipsoid(p, {-2.5F, -4.F, 9.5F}, {11.5F, 14.5F, 9.5F * shape_.bowl_depth}), 1.5F);
  for (const Tube& ridge : ridges_) d = blend_union(d, ridge.distance_within(p, d + 4.F), 3.F);
  d = blend_union(d, rim_.distance_within(p, d + 3.F), 2.F);
  d = blend_union(d, crus_.distance_within(p, d + 3.F), 2.F);
  d = blend_difference(d, groove_.distance_within(p, 1.F - d), 0.6F);
  return blend_difference(d, canal_.distance_within(p, 1.F - d), 1.F);
}

}  // namespace holdfast::sim
