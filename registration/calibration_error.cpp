// SPDX-License-Identifier: Apache-2.0
#include "registration/calibration_error.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/Eigenvalues>
#include <Eigen/QR>
#include <opencv2/calib3d.hpp>

#include "registration/triangulation.hpp"
#include "registration/working_volume.hpp"

namespace holdfast::registration {
namespace {

constexpr double kVisibleVariance = 0.05;  // of the corners'

using Pose = Eigen::Matrix<double, 6, 1>;

/// Pixels of the board's corners: left x, y of all, then right x, y of all.
Eigen::VectorXd projected(const std::vector<cv::Point3d>& board, const Pose& pose,
                          const ZoomCalibration& zoom) {
  cv::Vec3d r(pose[0], pose[1], pose[2]), t(pose[3], pose[4], pose[5]);
  cv::Vec3d r_stereo, r_right, t_right;
  cv::Rodrigues(zoom.R, r_stereo);
  cv::composeRT(r, t, r_stereo, zoom.T, r_right, t_right);
  std::vector<cv::Point2d> left, right;
  cv::projectPoints(board, r, t, zoom.camera_matrix_left, zoom.distortion_left, left);
  cv::projectPoints(board, r_right, t_right, zoom.camera_matrix_right, zoom.distortion_right,
                    right);
  Eigen::VectorXd pixels(static_cast<Eigen::Index>(4 * board.size()));
  Eigen::Index at = 0;
  for (const auto* side : {&left, &right})
    for (const cv::Point2d& p : *side) {
      pixels[at++] = p.x;
      pixels[at++] = p.y;
    }
  return pixels;
}

Eigen::VectorXd observed(const BoardPair& pair) {
  Eigen::VectorXd pixels(static_cast<Eigen::Index>(4 * pair.left.size()));
  Eigen::Index at = 0;
  for (const auto* side : {&pair.left, &pair.right})
    for (const cv::Point2d& p : *side) {
      pixels[at++] = p.x;
      pixels[at++] = p.y;
    }
  return pixels;
}

Eigen::MatrixXd pose_jacobian(const std::vector<cv::Point3d>& board, const Pose& pose,
                              const ZoomCalibration& zoom) {
  Eigen::MatrixXd jacobian(static_cast<Eigen::Index>(4 * board.size()), 6);
  for (Eigen::Index i = 0; i < 6; ++i) {
    const double step = i < 3 ? 1e-5 : 1e-3;
    Pose up = pose, down = pose;
    up[i] += step;
    down[i] -= step;
    jacobian.col(i) = (projected(board, up, zoom) - projected(board, down, zoom)) / (2 * step);
  }
  return jacobian;
}

std::vector<cv::Point3d> points_of(const std::vector<Eigen::Vector3d>& board_mm) {
  std::vector<cv::Point3d> points;
  for (const auto& p : board_mm) points.emplace_back(p.x(), p.y(), p.z());
  return points;
}

Pose fitted_pose(const BoardPair& pair, const std::vector<Eigen::Vector3d>& board_mm,
                 const ZoomCalibration& zoom) {
  const auto board = points_of(board_mm);
  const Eigen::VectorXd seen = observed(pair);
  Pose pose = triangulated_pose(pair.left, pair.right, board_mm, zoom);
  for (int i = 0; i < 6; ++i) {
    const Eigen::MatrixXd jacobian = pose_jacobian(board, pose, zoom);
    pose += jacobian.colPivHouseholderQr().solve(seen - projected(board, pose, zoom));
  }
  return pose;
}

double rms_of_points(const Eigen::VectorXd& residual) {
  return std::sqrt(2 * residual.squaredNorm() / static_cast<double>(residual.size()));
}

}  // namespace

ViewError view_error(const BoardPair& pair, const std::vector<Eigen::Vector3d>& board_mm,
                     const ZoomCalibration& zoom) {
  const auto board = points_of(board_mm);
  const Pose pose = fitted_pose(pair, board_mm, zoom);
  const Eigen::VectorXd residual = observed(pair) - projected(board, pose, zoom);
  ViewError error;
  error.reprojection_left_px = rms_of_points(residual.head(residual.size() / 2));
  error.reprojection_right_px = rms_of_points(residual.tail(residual.size() / 2));
  std::vector<Eigen::Vector3d> corners;
  double squares = 0;
  for (const TriangulatedPoint& point : triangulate(pair.left, pair.right, zoom)) {
    corners.push_back(point.p_camera_mm);
    squares += point.epipolar_px * point.epipolar_px;
  }
  error.epipolar_px = std::sqrt(squares / static_cast<double>(corners.size()));
  error.board_mm = rigid_residual_mm(corners, board_mm);
  return error;
}

double predicted_nonrigid_mm(const ZoomCalibration& zoom, int image_width_px, int image_height_px,
                             double depth_mm) {
  constexpr double kUnknown = std::numeric_limits<double>::infinity();
  if (zoom.parameter_covariance.size() == 0) return kUnknown;
  const WorkingVolume volume = working_volume(zoom, image_width_px, image_height_px, depth_mm);
  if (volume.p_camera_mm.size() < 8) return kUnknown;
  const Eigen::MatrixXd moves =
      displacements(volume, zoom, covariance_root(zoom.parameter_covariance));
  const double squares = without_rigid(volume.p_camera_mm, moves).squaredNorm();
  return std::isfinite(squares)
             ? std::sqrt(squares / static_cast<double>(volume.p_camera_mm.size()))
             : kUnknown;
}

double covariance_inflation(const std::vector<ZoomViews>& held_out,
                            const std::vector<ZoomCalibration>& fold,
                            const std::vector<Eigen::Vector3d>& board_mm, double corner_sigma_px) {
  const auto board = points_of(board_mm);
  double excess = 0, predicted = 0;
  for (std::size_t z = 0; z < held_out.size(); ++z) {
    const ZoomCalibration& zoom = fold[z];
    const Eigen::MatrixXd root = covariance_root(zoom.parameter_covariance);
    const Eigen::VectorXd parameters = parameter_vector(zoom);
    for (const BoardPair& pair : held_out[z].pairs) {
      const Pose pose = fitted_pose(pair, board_mm, zoom);
      const Eigen::VectorXd here = projected(board, pose, zoom);
      Eigen::MatrixXd spread(here.size(), root.cols());
      constexpr double kStep = 0.1;
      for (Eigen::Index k = 0; k < root.cols(); ++k)
        spread.col(k) =
            (projected(board, pose, with_parameters(zoom, parameters + kStep * root.col(k))) -
             here) /
            (kStep * corner_sigma_px);
      const Eigen::MatrixXd jacobian = pose_jacobian(board, pose, zoom);
      spread -= jacobian * jacobian.colPivHouseholderQr().solve(spread);
      const Eigen::VectorXd residual = (observed(pair) - here) / corner_sigma_px;
      const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> modes{spread.transpose() * spread};
      // Directions in which the calibration's error is at all visible beside the corners' noise.
      for (Eigen::Index k = 0; k < modes.eigenvalues().size(); ++k) {
        const double variance = modes.eigenvalues()[k];
        if (!(variance >= kVisibleVariance)) continue;
        const double along =
            (spread * modes.eigenvectors().col(k)).dot(residual) / std::sqrt(variance);
        excess += along * along - 1;
        predicted += variance;
      }
    }
  }
  return predicted > 0 ? std::max(1.0, excess / predicted) : 1.0;
}

}  // namespace holdfast::registration
