// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/relief_phantom.hpp"

#include <cmath>

#include <opencv2/aruco.hpp>

namespace holdfast::sim {
namespace {

using Eigen::Vector3d;

double relief_mm(double x, double y, double phase) {
  double z = 2.0 * std::sin(x / 9 + phase) * std::cos(y / 7) + 1.0 * std::sin((x + y) / 4 + phase);
  z += 6 * std::exp(-(x * x + y * y) / 250);
  // A post with walls steep enough to hide and to shade.
  const double r = std::hypot(x - 14, y + 4);
  return z + 14 / (1 + std::exp((r - 5) / 0.3));
}

LitSurface relief(double phase) {
  LitSurface s;
  s.look.texture_contrast = 0.12F;
  s.look.texture_mm = 0.6F;
  constexpr int kColumns = 250, kRows = 175;
  constexpr double kStepMm = 0.4, kX0 = -50, kY0 = -35, kH = 1e-3;
  for (int j = 0; j <= kRows; ++j)
    for (int i = 0; i <= kColumns; ++i) {
      const double x = kX0 + kStepMm * i, y = kY0 + kStepMm * j;
      const auto z = [phase](double u, double v) { return relief_mm(u, v, phase); };
      s.vertices_mm.push_back(Vector3d(x, y, z(x, y)).cast<float>());
      s.normals.push_back(Vector3d((z(x - kH, y) - z(x + kH, y)) / (2 * kH),
                                   (z(x, y - kH) - z(x, y + kH)) / (2 * kH), 1)
                              .normalized()
                              .cast<float>());
    }
  for (std::uint32_t j = 0; j < kRows; ++j)
    for (std::uint32_t i = 0; i < kColumns; ++i) {
      const std::uint32_t a = j * (kColumns + 1) + i, b = a + 1, c = a + kColumns + 1, d = c + 1;
      s.triangles.push_back({a, b, c});
      s.triangles.push_back({b, d, c});
    }
  return s;
}

// A square facing +z of T_ct_plate, its print's upper edge towards +y.
LitSurface plate(const Eigen::Isometry3d& T_ct_plate, double half_mm, cv::Mat_<float> print) {
  LitSurface s;
  const Eigen::Vector3f n = T_ct_plate.linear().col(2).cast<float>();
  for (const auto& [x, y] : {std::pair{-1, 1}, {1, 1}, {1, -1}, {-1, -1}}) {
    s.vertices_mm.push_back((T_ct_plate * Vector3d(half_mm * x, half_mm * y, 0)).cast<float>());
    s.normals.push_back(n);
    s.uv.emplace_back(0.5F + 0.5F * static_cast<float>(x), 0.5F - 0.5F * static_cast<float>(y));
  }
  s.triangles = {{0, 2, 1}, {0, 3, 2}};
  s.look.albedo_visible = s.look.albedo_nir = 0.75F;
  s.look.roughness = 0.6F;
  s.look.print = std::move(print);
  return s;
}

cv::Mat_<float> marker_print(int id) {
  cv::Mat bits;
  cv::aruco::drawMarker(cv::aruco::getPredefinedDictionary(cv::aruco::DICT_4X4_50), id, 6, bits, 1);
  cv::Mat_<float> print(8, 8, 1.F);  // a white cell around
  for (int j = 0; j < 6; ++j)
    for (int i = 0; i < 6; ++i) print(j + 1, i + 1) = bits.at<std::uint8_t>(j, i) > 0 ? 1.F : 0.07F;
  return print;
}

}  // namespace

Phantom make_relief_phantom(std::uint32_t seed) {
  const double phase = 0.7 * seed;
  Phantom phantom;
  phantom.name = "relief";
  phantom.surfaces.push_back(relief(phase));
  constexpr double kSideMm = 9;
  for (int id = 0; id < 4; ++id) {
    Eigen::Isometry3d T_ct_marker = Eigen::Isometry3d::Identity();
    T_ct_marker.translate(Vector3d(id % 2 == 0 ? -36 : 36, id < 2 ? -24 : 24, 9.0 + 1.5 * id));
    T_ct_marker.rotate(Eigen::AngleAxisd(0.12 * id, Vector3d(1, 0.5, 0).normalized()));
    phantom.surfaces.push_back(plate(T_ct_marker, 0.5 * kSideMm / 6 * 8, marker_print(id)));
    phantom.markers.push_back({id, kSideMm, T_ct_marker, T_ct_marker * Vector3d(0, 0, -1)});
  }
  phantom.region_of_interest_mm = {Vector3d(-25, -18, -5), Vector3d(25, 18, 15)};
  phantom.scan_box_mm = {Vector3d(-55, -40, -10), Vector3d(55, 40, 25)};
  phantom.hounsfield = [](const Eigen::Vector3f&) { return -1000.F; };
  phantom.p_focus_ct_mm = Vector3d(0, 0, 3);
  phantom.n_view_ct = Vector3d::UnitZ();
  return phantom;
}

LitSurface make_dot_plate(const std::vector<Eigen::Vector2d>& centres_mm, double diameter_mm,
                          double half_size_mm) {
  constexpr double kTexelMm = 0.02;
  const int size = static_cast<int>(std::lround(2 * half_size_mm / kTexelMm));
  cv::Mat_<float> print(size, size, 1.F);
  const double radius = 0.5 * diameter_mm / kTexelMm;
  for (const Eigen::Vector2d& c : centres_mm) {
    const double cx = (c.x() + half_size_mm) / kTexelMm, cy = (half_size_mm - c.y()) / kTexelMm;
    const int reach = static_cast<int>(radius) + 2;
    for (int y = static_cast<int>(cy) - reach; y <= static_cast<int>(cy) + reach; ++y)
      for (int x = static_cast<int>(cx) - reach; x <= static_cast<int>(cx) + reach; ++x) {
        const double inside =
            std::clamp(radius - std::hypot(x + 0.5 - cx, y + 0.5 - cy) + 0.5, 0.0, 1.0);
        print(y, x) -= static_cast<float>(0.93 * inside);
      }
  }
  return plate(Eigen::Isometry3d::Identity(), half_size_mm, print);
}

}  // namespace holdfast::sim
