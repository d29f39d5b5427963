// SPDX-License-Identifier: Apache-2.0
#include "tests/registration/hand_eye/drawn_spots.hpp"

#include <cmath>

#include <fmt/format.h>
#include <opencv2/calib3d.hpp>

#include "registration/triangulation.hpp"
#include "registration/working_volume.hpp"

namespace holdfast::registration::test {
namespace {

constexpr int kWidth = 1600, kHeight = 1200;
constexpr double kFocusMm = 200;

}  // namespace

ZoomCalibration drawn_calibration() {
  ZoomCalibration zoom;
  zoom.zoom = 1.3;
  zoom.focus_mm = kFocusMm;
  zoom.camera_matrix_left = {5000, 0, 803, 0, 5000, 597, 0, 0, 1};
  zoom.camera_matrix_right = {5010, 0, 796, 0, 5010, 601, 0, 0, 1};
  zoom.distortion_left = (cv::Mat_<double>(1, 5) << -0.1, 0.01, 0.0005, -0.0003, 0);
  zoom.distortion_right = (cv::Mat_<double>(1, 5) << -0.09, 0, -0.0002, 0.0004, 0);
  const double half = std::asin(12 / kFocusMm);
  cv::Matx33d R;
  cv::Rodrigues(cv::Vec3d(0.002, 2 * half, 0.003), R);
  zoom.R = R;
  zoom.T = -(R * cv::Vec3d(24 * std::cos(half), 0, 24 * std::sin(half)));
  zoom.rms_px = 0.03;
  zoom.pairs_used = 19;
  Eigen::VectorXd sigma(24);  // fx fy cx cy k1 k2 p1 p2 k3 of both, R, T
  sigma << 1, 1, 0.2, 0.2, 2e-3, 0, 2e-5, 2e-5, 0, 1, 1, 0.2, 0.2, 2e-3, 0, 2e-5, 2e-5, 0, 2e-5,
      2e-5, 2e-5, 0.005, 0.005, 0.02;
  zoom.parameter_covariance = sigma.cwiseAbs2().asDiagonal();
  return zoom;
}

Eigen::Vector2d seen(const ZoomCalibration& zoom, bool is_left, const Eigen::Vector3d& p) {
  cv::Vec3d rotation(0, 0, 0);
  if (!is_left) cv::Rodrigues(zoom.R, rotation);
  std::vector<cv::Point2d> pixels;
  cv::projectPoints(std::vector<cv::Point3d>{{p.x(), p.y(), p.z()}}, rotation,
                    is_left ? cv::Vec3d(0, 0, 0) : zoom.T,
                    is_left ? zoom.camera_matrix_left : zoom.camera_matrix_right,
                    is_left ? zoom.distortion_left : zoom.distortion_right, pixels);
  return {pixels[0].x, pixels[0].y};
}

Eigen::Vector3d triangulated(const HandEyeInput& input, const HandEyeSpot& spot) {
  const auto pixel = [](const ImageSpot& s) {
    return std::vector<cv::Point2d>{{s.centre_px.x(), s.centre_px.y()}};
  };
  return triangulate(pixel(spot.left), pixel(spot.right), input.calibration)[0].p_camera_mm;
}

DrawnHandEye draw_hand_eye(const DrawnSpots& options) {
  std::mt19937_64 random(options.seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform(-1, 1);
  const auto vector = [&](auto& distribution) {
    const double x = distribution(random), y = distribution(random), z = distribution(random);
    return Eigen::Vector3d(x, y, z);
  };
  DrawnHandEye drawn;
  drawn.input.calibration = drawn_calibration();
  drawn.input.image_width_px = kWidth;
  drawn.input.image_height_px = kHeight;
  const Eigen::MatrixXd root = covariance_root(drawn.input.calibration.parameter_covariance);
  Eigen::VectorXd step(root.cols());
  for (double& value : step) value = options.calibration_sigma * normal(random);
  drawn.truth = with_parameters(drawn.input.calibration,
                                parameter_vector(drawn.input.calibration) + root * step);
  drawn.T_robot_camera = Eigen::Translation3d(400, -80, 300) *
                         Eigen::AngleAxisd(2.6, Eigen::Vector3d(0.8, 0.5, -0.2).normalized());
  for (int i = 0; i < options.count; ++i) {
    const double x = 0.5 * options.width_mm * uniform(random);
    const double y = 0.5 * options.height_mm * uniform(random);
    const Eigen::Vector3d p(x, y, kFocusMm + options.relief_mm * uniform(random));
    HandEyeSpot spot;
    spot.name = fmt::format("s{:02}", i + 1);
    for (const bool is_left : {true, false}) {
      ImageSpot& image = is_left ? spot.left : spot.right;
      image.centre_px = seen(drawn.truth, is_left, p);
      const double dx = normal(random), dy = normal(random);
      image.centre_px += options.pixel_sigma_px * Eigen::Vector2d(dx, dy);
      const double sigma = std::max(options.pixel_sigma_px, 1e-3);
      image.covariance_px2 = sigma * sigma * Eigen::Matrix2d::Identity();
    }
    const Eigen::Vector3d q = drawn.T_robot_camera * p;
    spot.robot.sigma_mm = std::max(options.robot_sigma_mm, 1e-4);
    spot.robot.point_mm = q;
    if (options.has_beams) {
      const Eigen::Vector3d origin =
          drawn.T_robot_camera * Eigen::Vector3d(60 * uniform(random), 40 * uniform(random), 20);
      const double length = (q - origin).norm();
      const Eigen::Vector3d turn = options.robot_sigma_rad * length * vector(normal);
      spot.robot.sigma_rad = std::max(options.robot_sigma_rad, 1e-6);
      spot.robot.direction = (q + turn - origin).normalized();
      spot.robot.point_mm = origin;
    }
    spot.robot.point_mm += options.robot_sigma_mm * vector(normal);
    drawn.input.spots.push_back(spot);
  }
  return drawn;
}

}  // namespace holdfast::registration::test
