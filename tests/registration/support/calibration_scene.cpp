// SPDX-License-Identifier: Apache-2.0
#include "tests/registration/support/calibration_scene.hpp"

#include <cmath>
#include <numbers>
#include <random>

#include "registration/triangulation.hpp"

namespace holdfast::registration::test {

struct CalibrationScene::Side {
  double f_px, cx, cy;
  Eigen::Isometry3d T_camera_left;
  double k1, k2, centre_x, centre_y, foreign_px, phase, wave;
};

// Two channels of one objective, toed in towards the focus at 200 mm.
CalibrationScene::Side CalibrationScene::side(double zoom, bool is_left) const {
  const auto d = draws_.row(is_left ? 0 : 1);
  const double x = std::log(zoom / 1.3);
  Side s{};
  s.f_px = (3050 + 20 * d[0]) * std::pow(zoom, 1.02 + 0.01 * d[1]);
  std::seed_seq seeds{options_.seed, static_cast<std::uint32_t>(std::lround(zoom * 1e4)),
                      is_left ? 1U : 2U};
  std::mt19937 random(seeds);
  std::normal_distribution<double> normal;
  s.cx = 1227 + 15 * d[2] + 12 * d[3] * x + options_.seating_px * normal(random);
  s.cy = 1026 + 15 * d[4] + 12 * d[5] * x + options_.seating_px * normal(random);
  s.k1 = -0.06 + 0.01 * d[6] + 0.04 * x + 0.03 * x * x;
  s.k2 = 0.1 + 0.02 * d[7];
  s.centre_x = (is_left ? 0.02 : -0.02) + 0.004 * d[8];  // seen off the objective's axis
  s.centre_y = 0.004 * d[9];
  s.foreign_px = options_.foreign_distortion_px * (1 + 0.2 * x);
  s.phase = d[10];
  s.wave = 1.3 + 0.2 * std::abs(d[11]);
  const double base_mm = 24 + 0.3 * draws_(0, 12), toe_rad = base_mm / 200;
  const Eigen::Vector3d drift(0.2 * draws_(0, 13) * x, 0.1 + 0.1 * draws_(0, 14), 2 * x);
  s.T_camera_left = Eigen::Isometry3d::Identity();
  if (is_left) return s;
  const Eigen::Vector3d centre =
      Eigen::Vector3d(base_mm * std::cos(toe_rad / 2), 0, base_mm * std::sin(toe_rad / 2)) + drift;
  s.T_camera_left =
      (Eigen::Translation3d(centre) * Eigen::AngleAxisd(-toe_rad, Eigen::Vector3d::UnitY()) *
       Eigen::AngleAxisd(0.004 * draws_(0, 15), Eigen::Vector3d::UnitZ()))
          .inverse();
  return s;
}

CalibrationScene::CalibrationScene(const SceneOptions& options) : options_(options) {
  std::mt19937 random(options.seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform(-1, 1);
  for (Eigen::Index i = 0; i < draws_.size(); ++i) draws_(i) = normal(random);
  for (const double zoom : options.zooms) {
    ZoomViews& views = views_.emplace_back(ZoomViews{zoom, {}});
    while (static_cast<int>(views.pairs.size()) < options.pairs) {
      const double z_mm = 200 + 8 * uniform(random);
      const double half_mm = 0.5 * kWidth / (3050 * zoom) * z_mm;
      const Eigen::Isometry3d T_camera_board =
          Eigen::Translation3d(0.75 * half_mm * uniform(random), 0.7 * half_mm * uniform(random),
                               z_mm) *
          Eigen::AngleAxisd(0.06 + options.tilt_rad * uniform(random), Eigen::Vector3d::UnitY()) *
          Eigen::AngleAxisd(options.tilt_rad * uniform(random), Eigen::Vector3d::UnitX()) *
          Eigen::AngleAxisd(0.3 * uniform(random), Eigen::Vector3d::UnitZ());
      BoardPair pair{"left_" + std::to_string(views.pairs.size()) + ".png", {}, {}};
      bool is_inside = true;
      for (Eigen::Vector3d p : board_.points_mm()) {
        const double u = p.x() / 12, v = p.y() / 6;
        p.z() = options.bend_mm * (u * u - 0.4 * u * v + 0.5 * v * v * v);
        for (const bool is_left : {true, false}) {
          const cv::Point2d seen = pixel(zoom, is_left, T_camera_board * p);
          is_inside = is_inside && seen.x > 30 && seen.y > 30 && seen.x < kWidth - 31 &&
                      seen.y < kHeight - 31;
          (is_left ? pair.left : pair.right)
              .emplace_back(seen.x + options.corner_noise_px * normal(random),
                            seen.y + options.corner_noise_px * normal(random));
        }
      }
      if (is_inside) views.pairs.push_back(pair);
    }
  }
}

cv::Point2d CalibrationScene::pixel(double zoom, bool is_left, const Eigen::Vector3d& p) const {
  const Side s = side(zoom, is_left);
  const Eigen::Vector3d q = s.T_camera_left * p;
  const double x = q.x() / q.z() - s.centre_x, y = q.y() / q.z() - s.centre_y;
  const double r2 = x * x + y * y, radial = 1 + r2 * (s.k1 + r2 * s.k2);
  const double edge = 0.5 * kWidth / s.f_px, pi = std::numbers::pi;
  // A smooth ripple over the image that no polynomial of OpenCV's follows.
  const double dx =
      s.foreign_px * std::sin(pi * s.wave * y / edge + s.phase) * std::cos(pi * x / edge);
  const double dy = s.foreign_px * std::cos(pi * s.wave * x / edge + 2 * s.phase);
  return {s.f_px * (x * radial + s.centre_x) + s.cx + dx,
          s.f_px * (y * radial + s.centre_y) + s.cy + dy};
}

double CalibrationScene::nonrigid_error_mm(const ZoomCalibration& calibration, double zoom) const {
  std::vector<Eigen::Vector3d> truth, found;
  std::vector<cv::Point2d> left, right;
  const double half_mm = 0.5 * kWidth / (3050 * zoom) * 200;
  for (int i = -4; i <= 4; ++i)
    for (int j = -4; j <= 4; ++j)
      for (const double z : {190.0, 200.0, 210.0}) {
        const Eigen::Vector3d p(0.8 * half_mm * i / 4, 0.7 * half_mm * j / 4, z);
        const cv::Point2d l = pixel(zoom, true, p), r = pixel(zoom, false, p);
        if (l.x < 0 || l.y < 0 || l.x > kWidth - 1 || l.y > kHeight - 1) continue;
        if (r.x < 0 || r.y < 0 || r.x > kWidth - 1 || r.y > kHeight - 1) continue;
        truth.push_back(p);
        left.push_back(l);
        right.push_back(r);
      }
  for (const auto& point : triangulate(left, right, calibration))
    found.push_back(point.p_camera_mm);
  return rigid_residual_mm(found, truth);
}

}  // namespace holdfast::registration::test
