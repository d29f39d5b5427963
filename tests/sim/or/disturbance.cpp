// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/disturbance.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <limits>
#include <numbers>
#include <string>

#include <fmt/format.h>
#include <opencv2/imgproc.hpp>

#include "rt/core/error.hpp"

namespace holdfast::sim {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kTwoPi = 2 * std::numbers::pi;
constexpr int kCoarsePx = 16;  // smoke and lines of sight vary no faster

double smooth(double x) {
  const double s = std::clamp(x, 0.0, 1.0);
  return s * s * (3 - 2 * s);
}

// 0 before and after, 1 in the middle half.
double come_and_go(double share) {
  return smooth(4 * share) * smooth(4 * (1 - share));
}

// In -1..1, of a lattice of random values: the same place has the same value.
double lattice(int x, int y, int layer) {
  auto h = static_cast<std::uint32_t>(x) * 0x9E3779B1U ^
           static_cast<std::uint32_t>(y) * 0x85EBCA77U ^
           static_cast<std::uint32_t>(layer) * 0xC2B2AE3DU;
  h = (h ^ (h >> 15U)) * 0x2C1B3C6DU;
  h = (h ^ (h >> 12U)) * 0x297A2D39U;
  return static_cast<double>((h ^ (h >> 15U)) & 0xFFFFU) / 32767.5 - 1;
}

double noise(const Vector2d& at, int layer) {
  const double fx = std::floor(at.x()), fy = std::floor(at.y());
  const int x = static_cast<int>(fx), y = static_cast<int>(fy);
  const double sx = smooth(at.x() - fx), sy = smooth(at.y() - fy);
  const double top = std::lerp(lattice(x, y, layer), lattice(x + 1, y, layer), sx);
  const double bottom = std::lerp(lattice(x, y + 1, layer), lattice(x + 1, y + 1, layer), sx);
  return std::lerp(top, bottom, sy);
}

// Three octaves, the largest of period 1; about -1..1.
double billows(const Vector2d& at, int layer) {
  return 0.6 * noise(at, layer) + 0.3 * noise(2.1 * at, layer + 1) +
         0.15 * noise(4.3 * at, layer + 2);
}

// A field over the image, worked out at every sixteenth pixel.
template <typename Field>
cv::Mat_<float> over_image(cv::Size size, const Field& field) {
  cv::Mat_<float> coarse(size.height / kCoarsePx + 2, size.width / kCoarsePx + 2);
  for (int y = 0; y < coarse.rows; ++y)
    for (int x = 0; x < coarse.cols; ++x)
      coarse(y, x) = static_cast<float>(field(Vector2d(x, y) * kCoarsePx));
  cv::Mat_<float> fine;
  cv::resize(coarse, fine, {}, kCoarsePx, kCoarsePx, cv::INTER_LINEAR);
  return fine(cv::Rect({}, size));
}

// The picture's coarse light, without its texture.
cv::Mat_<float> shading(const cv::Mat_<float>& light) {
  cv::Mat_<float> mean;
  cv::blur(light, mean, {31, 31});
  return mean;
}

// Smoke of two-way optical thickness: what is behind it fades, and it is lit itself.
void draw_smoke(cv::Mat_<float>& light, double thickness, double t_s) {
  constexpr double kOwnLightDn = 110;
  if (thickness <= 0) return;
  const cv::Mat_<float> passes = over_image(light.size(), [&](const Vector2d& at) {
    const Vector2d drifting = (at - t_s * Vector2d(170, -60)) / 420;
    const double roll = 0.35 * billows(at / 300 - Vector2d(0, 0.8 * t_s), 20);
    return std::exp(-1.6 * thickness *
                    std::max(0.0, 1 + 0.9 * billows(drifting + Vector2d(roll, roll), 10)));
  });
  for (int y = 0; y < light.rows; ++y)
    for (int x = 0; x < light.cols; ++x)
      light(y, x) =
          passes(y, x) * light(y, x) + (1 - passes(y, x)) * static_cast<float>(kOwnLightDn);
}

// Covered where `at` is right of the edge; the edge is out of focus and casts a shadow before it.
void draw_occlusion(cv::Mat_<float>& light, double covered, double t_s) {
  constexpr double kSoftPx = 40, kShadowPx = 160;
  if (covered <= 0) return;
  const Vector2d tremor(6 * std::sin(kTwoPi * 4.1 * t_s), 4 * std::sin(kTwoPi * 5.3 * t_s + 1));
  const double travel = light.cols + 2 * (kSoftPx + kShadowPx);
  const double edge = light.cols + kSoftPx + kShadowPx - covered * travel;
  const cv::Mat_<float> cover = over_image(light.size(), [&](const Vector2d& at) {
    return smooth((at.x() - edge + 60 * noise({at.y() / 200, 0}, 30)) / kSoftPx);
  });
  const cv::Mat_<float> shadow = over_image(light.size(), [&](const Vector2d& at) {
    return 1 - 0.5 * smooth((at.x() - edge + kShadowPx) / kShadowPx);
  });
  const cv::Mat_<float> thing = over_image(light.size(), [&](const Vector2d& at) {
    return 55 + 25 * billows((at - Vector2d(edge, 0) + tremor) / 150, 40);
  });
  for (int y = 0; y < light.rows; ++y)
    for (int x = 0; x < light.cols; ++x)
      light(y, x) = (1 - cover(y, x)) * shadow(y, x) * light(y, x) + cover(y, x) * thing(y, x);
}

// Where the four places are, as shares of the image.
constexpr std::array<std::array<double, 2>, 4> kWounds{
    {{0.35, 0.4}, {0.62, 0.3}, {0.55, 0.68}, {0.25, 0.75}}};

using Points = std::vector<Vector3d>;

Points wounds(const Disturbances::Seen& seen) {
  const OpticalChannel& left = seen.shot.optics.left;
  Points points;
  for (const auto& wound : kWounds) {
    const cv::Rect& r = seen.shot.region;
    const SightLine line = left.sight_line({r.x + wound[0] * r.width, r.y + wound[1] * r.height});
    points.emplace_back(seen.T_ct_camera_first *
                        (line.origin_mm + seen.shot.optics.focus_mm * line.direction));
  }
  return points;
}

// How thick the film is, 0..1. Distances are taken along the image plane of the first frame: blood
// runs down walls as it runs along a floor.
double film(const Vector3d& p_first_mm, const Points& wounds_first_mm, double reach_mm) {
  constexpr double kRimMm = 0.4;
  const Vector2d at = p_first_mm.head<2>();
  double away_mm = std::numeric_limits<double>::infinity();
  for (const Vector3d& wound : wounds_first_mm)
    away_mm = std::min(away_mm, (at - wound.head<2>()).norm());
  if (away_mm > 1.4 * reach_mm) return 0;
  const double inside_mm = reach_mm * (1 + 0.35 * billows(at / 2.5, 50)) - away_mm;
  if (inside_mm <= 0) return 0;
  return smooth(inside_mm / kRimMm) * (0.8 + 0.2 * billows(at / 0.9, 60));
}

// A film lets a part of the light through to what it lies on and back, and scatters little itself.
void draw_blood(cv::Mat_<float>& light, const Disturbances::Seen& seen, double reach_mm) {
  constexpr double kThickness = 2.5, kOwnAlbedo = 0.3;
  if (reach_mm <= 0) return;
  const Eigen::Isometry3d T_first_ct = seen.T_ct_camera_first.inverse(Eigen::Isometry);
  const Eigen::Isometry3d T_first_camera = T_first_ct * seen.T_ct_camera;
  Points sources = wounds(seen);
  for (Vector3d& p : sources) p = T_first_ct * p;
  const cv::Rect& r = seen.shot.region;
  const OpticalChannel& left = seen.shot.optics.left;
  const auto slope = [&](int axis) {
    return over_image(light.size(), [&](const Vector2d& at) {
      return left.sight_line(at + Vector2d(r.x, r.y)).direction[axis];
    });
  };
  const cv::Mat_<float> slope_x = slope(0), slope_y = slope(1), mean = shading(light);
  cv::parallel_for_({0, light.rows}, [&](const cv::Range& rows) {
    for (int y = rows.start; y < rows.end; ++y)
      for (int x = 0; x < light.cols; ++x) {
        const auto z = static_cast<double>(seen.depth_mm(y, x));
        if (z <= 0) continue;
        const Vector3d direction(static_cast<double>(slope_x(y, x)),
                                 static_cast<double>(slope_y(y, x)), 1);
        const double thick = film(T_first_camera * (z * direction), sources, reach_mm);
        if (thick <= 0) continue;
        const auto passes = static_cast<float>(std::exp(-kThickness * thick));
        light(y, x) =
            passes * light(y, x) + (1 - passes) * static_cast<float>(kOwnAlbedo) * mean(y, x);
      }
  });
}

}  // namespace

Disturbances::Item Disturbances::item_of(std::string_view text) {
  static constexpr std::array<std::string_view, 6> kNames{"flicker", "defocus", "zoom",
                                                          "blood",   "smoke",   "occlusion"};
  const auto refused = [&](const std::string& why) {
    return InputError(fmt::format("disturbances: \"{}\": {}", text, why));
  };
  std::vector<std::string_view> parts;
  for (std::size_t begin = 0; begin <= text.size();) {
    const std::size_t end = std::min(text.find(':', begin), text.size());
    parts.push_back(text.substr(begin, end - begin));
    begin = end + 1;
  }
  const auto* const known = std::find(kNames.begin(), kNames.end(), parts[0]);
  if (known == kNames.end())
    throw refused(fmt::format("is not one of {}", fmt::join(kNames, ", ")));
  if (parts.size() < 3 || parts.size() > 4) throw refused("must be NAME:FROM_S:FOR_S[:STRENGTH]");
  Item item{static_cast<Kind>(known - kNames.begin()), 0, 0, 1};
  const std::array<double*, 3> values{&item.from_s, &item.for_s, &item.strength};
  for (std::size_t i = 1; i < parts.size(); ++i) {
    double& value = *values.at(i - 1);
    const auto [end, error] =
        std::from_chars(parts[i].data(), parts[i].data() + parts[i].size(), value);
    if (error != std::errc{} || end != parts[i].data() + parts[i].size())
      throw refused(fmt::format("\"{}\" is not a number", parts[i]));
  }
  constexpr double kTimeMax = 86400, kStrengthMax = 5;
  if (!(item.from_s >= 0 && item.from_s <= kTimeMax && item.for_s > 0 && item.for_s <= kTimeMax))
    throw refused(fmt::format("must begin at 0..{0} s and last 0..{0} s", kTimeMax));
  if (item.kind == Kind::zoom ? !(parts.size() == 4 && item.strength >= Microscope::kZoomMin &&
                                  item.strength <= Microscope::kZoomMax)
                              : !(item.strength > 0 && item.strength <= kStrengthMax))
    throw refused(fmt::format("strength must be 0..{}, of a zoom {} to {}", kStrengthMax,
                              Microscope::kZoomMin, Microscope::kZoomMax));
  return item;
}

Disturbances::Disturbances(std::string_view program) {
  if (program.empty()) return;
  for (std::size_t begin = 0; begin <= program.size();) {
    const std::size_t end = std::min(program.find(',', begin), program.size());
    items_.push_back(item_of(program.substr(begin, end - begin)));
    begin = end + 1;
  }
}

std::optional<double> Disturbances::zoom(double t_s) const {
  std::optional<double> zoom;
  for (const Item& item : items_)
    if (item.kind == Kind::zoom && t_s >= item.from_s && t_s < item.from_s + item.for_s)
      zoom = item.strength;
  return zoom;
}

void Disturbances::set(RoomShot& shot, double t_s) const {
  constexpr double kSwing = 0.25, kDefocusPx = 4;
  for (const Item& item : items_) {
    const double since_s = t_s - item.from_s, share = since_s / item.for_s;
    if (share <= 0 || share >= 1) continue;
    if (item.kind == Kind::flicker)
      shot.sensor.exposure *= std::max(0.05, 1 + kSwing * item.strength *
                                                     (0.6 * std::sin(kTwoPi * 2 * since_s) +
                                                      0.4 * std::sin(kTwoPi * 7.3 * since_s)));
    if (item.kind == Kind::defocus)
      shot.optics.blur_px =
          std::hypot(shot.optics.blur_px, kDefocusPx * item.strength * come_and_go(share));
  }
}

void Disturbances::draw(cv::Mat_<float>& light, const Seen& seen, double t_s) const {
  constexpr double kReachMm = 6, kSlideS = 0.2;
  // From the site outwards: what is nearer to the lens is drawn last.
  for (const Kind kind : {Kind::blood, Kind::smoke, Kind::occlusion})
    for (const Item& item : items_) {
      const double since_s = t_s - item.from_s, share = since_s / item.for_s;
      if (item.kind != kind || share <= 0) continue;
      if (kind == Kind::blood)
        draw_blood(light, seen, kReachMm * item.strength * std::sqrt(std::min(share, 1.0)));
      if (share >= 1) continue;
      if (kind == Kind::smoke) draw_smoke(light, item.strength * come_and_go(share), t_s);
      if (kind == Kind::occlusion)
        draw_occlusion(light, std::min({1.0, since_s / kSlideS, (item.for_s - since_s) / kSlideS}),
                       t_s);
    }
}

}  // namespace holdfast::sim
