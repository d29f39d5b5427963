// SPDX-License-Identifier: Apache-2.0
#include "registration/working_volume.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/QR>
#include <opencv2/calib3d.hpp>

#include "registration/triangulation.hpp"

namespace holdfast::registration {

WorkingVolume working_volume(const ZoomCalibration& zoom, int image_width_px, int image_height_px,
                             double depth_mm, const VolumeExtent& extent) {
  constexpr int kSteps = 4;
  const double w = image_width_px - 1.0, h = image_height_px - 1.0;
  cv::Vec3d rotation;
  cv::Rodrigues(zoom.R, rotation);
  WorkingVolume volume;
  for (int i = 0; i <= kSteps; ++i)
    for (int j = 0; j <= kSteps; ++j)
      for (const double share : {1 - extent.reach, 1.0, 1 + extent.reach}) {
        const double u = static_cast<double>(i) / kSteps - 0.5;
        const double v = static_cast<double>(j) / kSteps - 0.5;
        const cv::Point2d pixel(w * (0.5 + extent.field * u), h * (0.5 + extent.field * v));
        const auto ray = rays({pixel}, zoom.camera_matrix_left, zoom.distortion_left).front();
        const Eigen::Vector3d p = share * depth_mm * ray.homogeneous();
        std::vector<cv::Point2d> seen;
        cv::projectPoints(std::vector<cv::Point3d>{{p.x(), p.y(), p.z()}}, rotation, zoom.T,
                          zoom.camera_matrix_right, zoom.distortion_right, seen);
        if (!(seen[0].x >= 0 && seen[0].y >= 0 && seen[0].x <= w && seen[0].y <= h)) continue;
        volume.p_camera_mm.push_back(p);
        volume.left.push_back(pixel);
        volume.right.push_back(seen[0]);
      }
  return volume;
}

Eigen::MatrixXd displacements(const WorkingVolume& volume, const ZoomCalibration& zoom,
                              const Eigen::MatrixXd& changes) {
  constexpr double kStep = 1e-2;  // stays linear for a bad calibration
  const Eigen::VectorXd parameters = parameter_vector(zoom);
  Eigen::MatrixXd result(static_cast<Eigen::Index>(3 * volume.p_camera_mm.size()), changes.cols());
  for (Eigen::Index k = 0; k < changes.cols(); ++k) {
    const auto moved = triangulate(volume.left, volume.right,
                                   with_parameters(zoom, parameters + kStep * changes.col(k)));
    for (std::size_t i = 0; i < moved.size(); ++i)
      result.block<3, 1>(static_cast<Eigen::Index>(3 * i), k) =
          (moved[i].p_camera_mm - volume.p_camera_mm[i]) / kStep;
  }
  return result;
}

Eigen::MatrixXd rigid_motions(const std::vector<Eigen::Vector3d>& points_mm) {
  Eigen::MatrixXd motions(static_cast<Eigen::Index>(3 * points_mm.size()), 6);
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  for (const auto& p : points_mm) centre += p / static_cast<double>(points_mm.size());
  for (std::size_t i = 0; i < points_mm.size(); ++i) {
    const auto row = static_cast<Eigen::Index>(3 * i);
    const Eigen::Vector3d p = points_mm[i] - centre;
    motions.block<3, 3>(row, 0).setIdentity();
    motions.block<3, 3>(row, 3) << 0, p.z(), -p.y(), -p.z(), 0, p.x(), p.y(), -p.x(), 0;
  }
  return motions;
}

Eigen::MatrixXd without_rigid(const std::vector<Eigen::Vector3d>& points_mm,
                              const Eigen::MatrixXd& displacements) {
  const Eigen::MatrixXd motions = rigid_motions(points_mm);
  return displacements - motions * motions.colPivHouseholderQr().solve(displacements);
}

Eigen::MatrixXd covariance_in_own_frame(const ZoomCalibration& zoom, int image_width_px,
                                        int image_height_px, double depth_mm) {
  const WorkingVolume volume =
      working_volume(zoom, image_width_px, image_height_px, depth_mm, {0.9, 0.06});
  if (volume.p_camera_mm.size() < 8) return zoom.parameter_covariance;
  const Eigen::MatrixXd motions = rigid_motions(volume.p_camera_mm);
  // What each parameter does, all made alike strong, and the rigid part of it.
  const Eigen::VectorXd sigma = zoom.parameter_covariance.diagonal().cwiseMax(0).cwiseSqrt();
  Eigen::MatrixXd moves = displacements(volume, zoom, sigma.asDiagonal().toDenseMatrix());
  const Eigen::MatrixXd rigid = motions.colPivHouseholderQr().solve(moves);
  const Eigen::VectorXd strength = moves.colwise().norm().cwiseMax(1e-12).transpose();
  moves *= strength.cwiseInverse().asDiagonal();
  // The parameters that imitate each rigid motion.
  constexpr double kRidge = 1e-8;
  Eigen::MatrixXd normal = moves.transpose() * moves;
  normal.diagonal().array() += kRidge;
  const Eigen::MatrixXd imitation =
      strength.cwiseInverse().asDiagonal() * normal.ldlt().solve(moves.transpose() * motions);
  // In units of sigma: a change of the parameters less that which imitates its rigid part.
  const Eigen::MatrixXd less =
      Eigen::MatrixXd::Identity(sigma.size(), sigma.size()) - imitation * rigid;
  const Eigen::VectorXd inverse = sigma.unaryExpr([](double x) { return x > 0 ? 1 / x : 0.0; });
  const Eigen::MatrixXd correlation =
      inverse.asDiagonal() * zoom.parameter_covariance * inverse.asDiagonal();
  const Eigen::MatrixXd result =
      sigma.asDiagonal() * less * correlation * less.transpose() * sigma.asDiagonal();
  return 0.5 * (result + result.transpose());
}

Eigen::MatrixXd covariance_root(const Eigen::MatrixXd& covariance) {
  const Eigen::VectorXd scale = covariance.diagonal().cwiseMax(0).cwiseSqrt();
  const Eigen::VectorXd inverse = scale.unaryExpr([](double s) { return s > 0 ? 1 / s : 0.0; });
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(inverse.asDiagonal() * covariance *
                                                              inverse.asDiagonal());
  return scale.asDiagonal() * solver.eigenvectors() *
         solver.eigenvalues().cwiseMax(0).cwiseSqrt().asDiagonal();
}

}  // namespace holdfast::registration
