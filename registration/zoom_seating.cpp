// SPDX-License-Identifier: Apache-2.0
#include "registration/zoom_seating.hpp"

#include <cmath>

#include <Eigen/QR>
#include <opencv2/calib3d.hpp>

#include "registration/triangulation.hpp"

namespace holdfast::registration {

double learnt_seating_px(const std::vector<ZoomCalibration>& zooms, int image_width_px,
                         int image_height_px, double expected_px) {
  constexpr double kExpectedCounts = 4;
  const auto n = static_cast<Eigen::Index>(zooms.size());
  if (n < 4) return expected_px;
  const cv::Point2d middle(0.5 * (image_width_px - 1), 0.5 * (image_height_px - 1));
  Eigen::MatrixXd powers(n, 3);
  Eigen::VectorXd y_px(n);
  for (Eigen::Index z = 0; z < n; ++z) {
    const ZoomCalibration& zoom = zooms[static_cast<std::size_t>(z)];
    const double x = std::log(zoom.zoom / zooms.front().zoom);
    powers.row(z) << 1, x, x * x;
    const Eigen::Vector3d p =
        zoom.focus_mm *
        rays({middle}, zoom.camera_matrix_left, zoom.distortion_left).front().homogeneous();
    cv::Vec3d rotation;
    cv::Rodrigues(zoom.R, rotation);
    std::vector<cv::Point2d> seen;
    cv::projectPoints(std::vector<cv::Point3d>{{p.x(), p.y(), p.z()}}, rotation, zoom.T,
                      zoom.camera_matrix_right, zoom.distortion_right, seen);
    y_px[z] = seen.front().y;
  }
  const Eigen::VectorXd rest = y_px - powers * powers.colPivHouseholderQr().solve(y_px);
  const double freedom = static_cast<double>(n - 3);
  const double squares = 0.5 * rest.squaredNorm();  // both cameras' seating is in it
  return std::sqrt((kExpectedCounts * expected_px * expected_px + squares) /
                   (kExpectedCounts + freedom));
}

}  // namespace holdfast::registration
