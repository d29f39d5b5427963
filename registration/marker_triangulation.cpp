// SPDX-License-Identifier: Apache-2.0
#include "registration/marker_triangulation.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <fmt/format.h>
#include <opencv2/calib3d.hpp>
#include <opencv2/core/eigen.hpp>

#include "registration/triangulation.hpp"
#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

using Corners = Eigen::Matrix<double, 16, 1>;  // undistorted px: left x, y of four, then right
using Square = Eigen::Matrix<double, 7, 1>;    // change of rotation, position mm, side mm

struct Camera {
  explicit Camera(const ZoomCalibration& zoom) : calibration(zoom) {
    cv::cv2eigen(zoom.R, R);
    T = {zoom.T[0], zoom.T[1], zoom.T[2]};
  }
  ZoomCalibration calibration;
  Eigen::Matrix3d R;
  Eigen::Vector3d T;
  [[nodiscard]] double f(bool is_left) const {
    const cv::Matx33d& K =
        is_left ? calibration.camera_matrix_left : calibration.camera_matrix_right;
    return 0.5 * (K(0, 0) + K(1, 1));
  }
};

struct SquareFit {
  Eigen::Isometry3d T_camera_marker = Eigen::Isometry3d::Identity();
  double side_mm = 0, rms_px = 0;
  Eigen::Matrix<double, 7, 7> covariance;  // of Square about the fit
};

Corners undistorted(const DetectedMarker& left, const DetectedMarker& right, const Camera& camera) {
  Corners corners;
  Eigen::Index at = 0;
  for (const bool is_left : {true, false}) {
    const auto& pixels = is_left ? left.corners : right.corners;
    const ZoomCalibration& zoom = camera.calibration;
    for (const Eigen::Vector2d& ray :
         rays({pixels.begin(), pixels.end()},
              is_left ? zoom.camera_matrix_left : zoom.camera_matrix_right,
              is_left ? zoom.distortion_left : zoom.distortion_right)) {
      corners.segment<2>(at) = camera.f(is_left) * ray;
      at += 2;
    }
  }
  return corners;
}

/// In the detector's order: clockwise from the marker's own top left; y up, z towards the viewer.
Corners projected(const Eigen::Isometry3d& T_camera_marker, double side_mm, const Camera& camera) {
  Corners corners;
  const double h = side_mm / 2;
  const Eigen::Vector3d square[4] = {{-h, h, 0}, {h, h, 0}, {h, -h, 0}, {-h, -h, 0}};
  for (Eigen::Index i = 0; i < 4; ++i) {
    const Eigen::Vector3d p = T_camera_marker * square[i];
    const Eigen::Vector3d q = camera.R * p + camera.T;
    corners.segment<2>(2 * i) = camera.f(true) * p.head<2>() / p.z();
    corners.segment<2>(8 + 2 * i) = camera.f(false) * q.head<2>() / q.z();
  }
  return corners;
}

Eigen::Isometry3d moved(const Eigen::Isometry3d& T_camera_marker, const Square& change) {
  Eigen::Isometry3d result = T_camera_marker;
  const Eigen::Vector3d r = change.head<3>();
  if (r.norm() > 0)
    result.linear() =
        Eigen::AngleAxisd(r.norm(), r.normalized()).toRotationMatrix() * result.linear();
  result.translation() += change.segment<3>(3);
  return result;
}

/// From the four triangulated corners.
SquareFit first_square(const DetectedMarker& left, const DetectedMarker& right,
                       const Camera& camera) {
  const auto points = triangulate({left.corners.begin(), left.corners.end()},
                                  {right.corners.begin(), right.corners.end()}, camera.calibration);
  Eigen::Vector3d p[4];
  for (std::size_t i = 0; i < 4; ++i) p[i] = points[i].p_camera_mm;
  SquareFit fit;
  const Eigen::Vector3d x = (p[1] - p[0] + p[2] - p[3]).normalized();
  const Eigen::Vector3d z = x.cross(p[0] - p[3] + p[1] - p[2]).normalized();
  fit.T_camera_marker.linear() << x, z.cross(x), z;
  fit.T_camera_marker.translation() = (p[0] + p[1] + p[2] + p[3]) / 4;
  for (int i = 0; i < 4; ++i) fit.side_mm += (p[(i + 1) % 4] - p[i]).norm() / 4;
  return fit;
}

/// Weighted least squares from `fit`; the weights are those of the corners' covariance.
SquareFit fitted_square(SquareFit fit, const Corners& seen,
                        const Eigen::Matrix<double, 16, 16>& information, const Camera& camera) {
  for (int iteration = 0; iteration < 8; ++iteration) {
    const Corners here = projected(fit.T_camera_marker, fit.side_mm, camera);
    Eigen::Matrix<double, 16, 7> jacobian;
    for (Eigen::Index k = 0; k < 7; ++k) {
      Square step = Square::Zero();
      step[k] = 1e-5;
      jacobian.col(k) =
          (projected(moved(fit.T_camera_marker, step), fit.side_mm + step[6], camera) - here) /
          1e-5;
    }
    const Eigen::Matrix<double, 7, 7> normal = jacobian.transpose() * information * jacobian;
    const Eigen::LDLT<Eigen::Matrix<double, 7, 7>> solver(normal);
    const Square change = solver.solve(jacobian.transpose() * information * (seen - here));
    fit.T_camera_marker = moved(fit.T_camera_marker, change);
    fit.side_mm += change[6];
    fit.covariance = solver.solve(Eigen::Matrix<double, 7, 7>::Identity());
  }
  fit.rms_px =
      std::sqrt((seen - projected(fit.T_camera_marker, fit.side_mm, camera)).squaredNorm() / 8);
  return fit;
}

Eigen::Matrix<double, 16, 16> information_of(const DetectedMarker& left,
                                             const DetectedMarker& right) {
  Eigen::Matrix<double, 16, 16> covariance = Eigen::Matrix<double, 16, 16>::Zero();
  covariance.topLeftCorner<8, 8>() = left.covariance_px2;
  covariance.bottomRightCorner<8, 8>() = right.covariance_px2;
  covariance.diagonal().array() += 1e-6;
  return covariance.inverse();
}

Eigen::Vector3d point_of(const Eigen::Isometry3d& T_camera_marker, double offset_mm) {
  return T_camera_marker * Eigen::Vector3d(0, 0, -offset_mm);
}

struct Pair {
  const DetectedMarker *left, *right;
};

void check_twins(const std::vector<DetectedMarker>& markers, const char* side) {
  for (std::size_t i = 1; i < markers.size(); ++i)
    if (markers[i].id == markers[i - 1].id)
      throw RefusedError(fmt::format("aruco-{} is twice in the {} image", markers[i].id, side));
}

std::vector<Pair> paired(const std::vector<DetectedMarker>& left,
                         const std::vector<DetectedMarker>& right,
                         std::vector<std::string>& skipped) {
  std::vector<Pair> pairs;
  const auto find = [](const std::vector<DetectedMarker>& markers, int id) {
    const auto it = std::find_if(markers.begin(), markers.end(),
                                 [id](const DetectedMarker& m) { return m.id == id; });
    return it == markers.end() ? nullptr : &*it;
  };
  for (const DetectedMarker& marker : left) {
    const DetectedMarker* other = find(right, marker.id);
    if (other != nullptr)
      pairs.push_back({&marker, other});
    else
      skipped.push_back(fmt::format("aruco-{} is seen in the left image only", marker.id));
  }
  for (const DetectedMarker& marker : right)
    if (find(left, marker.id) == nullptr)
      skipped.push_back(fmt::format("aruco-{} is seen in the right image only", marker.id));
  return pairs;
}

void check_count(std::size_t count, bool is_any_seen, const std::vector<std::string>& skipped,
                 int least) {
  if (!is_any_seen)
    throw RefusedError(
        "no marker is found in either image: is the pattern on? its dots hide the markers");
  if (static_cast<int>(count) >= least) return;
  std::string names;
  for (const std::string& one : skipped) names += "; " + one;
  throw RefusedError(fmt::format("{} markers are seen by both cameras, at least {} are needed{}",
                                 count, least, names));
}

void check_marker(const LocatedMarker& marker, const MarkerOptions& options, double focus_mm) {
  const double depth_mm = marker.T_camera_marker.translation().z();
  if (!(marker.fit_px < options.worst_fit_px))
    throw RefusedError(fmt::format(
        "aruco-{}: the two images disagree by {:.2f} px, must be below {:g} px: left and right "
        "swapped, another zoom, or another calibration",
        marker.id, marker.fit_px, options.worst_fit_px));
  if (!(depth_mm > 0.5 * focus_mm && depth_mm < 1.5 * focus_mm))
    throw RefusedError(
        fmt::format("aruco-{}: lies at {:.1f} mm, must be within half of the working distance {:g} "
                    "mm: left and "
                    "right swapped, or another calibration",
                    marker.id, depth_mm, focus_mm));
  if (options.marker_mm > 0 &&
      !(std::abs(marker.side_mm / options.marker_mm - 1) < options.worst_side_share))
    throw RefusedError(
        fmt::format("aruco-{}: its side measures {:.3f} mm, must be {:g} mm within {:g} %: another "
                    "zoom, or another marker",
                    marker.id, marker.side_mm, options.marker_mm, 100 * options.worst_side_share));
}

/// Columns whose outer products sum to the covariance.
Eigen::MatrixXd square_root(const Eigen::MatrixXd& covariance) {
  const Eigen::VectorXd scale = covariance.diagonal().cwiseMax(0).cwiseSqrt();
  const Eigen::VectorXd inverse = scale.unaryExpr([](double s) { return s > 0 ? 1 / s : 0.0; });
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(inverse.asDiagonal() * covariance *
                                                              inverse.asDiagonal());
  return scale.asDiagonal() * solver.eigenvectors() *
         solver.eigenvalues().cwiseMax(0).cwiseSqrt().asDiagonal();
}

class Location {
 public:
  Location(std::vector<Pair> pairs, const ZoomCalibration& calibration,
           const MarkerOptions& options)
      : pairs_(std::move(pairs)), camera_(calibration), options_(options) {}

  void locate(MarkerSet& set) {
    const auto size = static_cast<Eigen::Index>(3 * pairs_.size());
    set.joint_covariance_mm2 = Eigen::MatrixXd::Zero(size, size);
    for (std::size_t i = 0; i < pairs_.size(); ++i) {
      const SquareFit fit = fit_one(pairs_[i], camera_, nullptr);
      const LocatedMarker marker = located(pairs_[i].left->id, fit);
      check_marker(marker, options_, camera_.calibration.focus_mm);
      const auto at = static_cast<Eigen::Index>(3 * i);
      set.joint_covariance_mm2.block<3, 3>(at, at) = image_covariance(fit);
      set.markers.push_back(marker);
      fits_.push_back(fit);
    }
    add_calibration(set.joint_covariance_mm2);
    for (std::size_t i = 0; i < pairs_.size(); ++i) {
      const auto at = static_cast<Eigen::Index>(3 * i);
      set.markers[i].covariance_mm2 = set.joint_covariance_mm2.block<3, 3>(at, at);
    }
  }

 private:
  static SquareFit fit_one(const Pair& pair, const Camera& camera, const SquareFit* start) {
    return fitted_square(start != nullptr ? *start : first_square(*pair.left, *pair.right, camera),
                         undistorted(*pair.left, *pair.right, camera),
                         information_of(*pair.left, *pair.right), camera);
  }

  [[nodiscard]] LocatedMarker located(int id, const SquareFit& fit) const {
    LocatedMarker marker;
    marker.id = id;
    marker.T_camera_marker = fit.T_camera_marker;
    marker.side_mm = fit.side_mm;
    marker.fit_px = fit.rms_px;
    marker.point_mm = point_of(fit.T_camera_marker, options_.offset_mm);
    return marker;
  }

  /// The corners' covariance, raised where the square fits them worse than it says.
  [[nodiscard]] Eigen::Matrix3d image_covariance(const SquareFit& fit) const {
    Eigen::Matrix<double, 3, 7> jacobian;
    const Eigen::Vector3d here = point_of(fit.T_camera_marker, options_.offset_mm);
    for (Eigen::Index k = 0; k < 7; ++k) {
      Square step = Square::Zero();
      step[k] = 1e-5;
      jacobian.col(k) =
          (point_of(moved(fit.T_camera_marker, step), options_.offset_mm) - here) / 1e-5;
    }
    constexpr double kTypicalPx = 0.03;
    const double excess = std::max(1.0, std::pow(fit.rms_px / kTypicalPx, 2));
    return excess * jacobian * fit.covariance * jacobian.transpose();
  }

  /// Every standard deviation of the calibration moves all markers together.
  void add_calibration(Eigen::MatrixXd& joint) const {
    const ZoomCalibration& zoom = camera_.calibration;
    if (zoom.parameter_covariance.size() == 0) return;
    const Eigen::MatrixXd root = square_root(zoom.parameter_covariance);
    const Eigen::VectorXd parameters = parameter_vector(zoom);
    constexpr double kStep = 0.1;
    for (Eigen::Index k = 0; k < root.cols(); ++k) {
      if (root.col(k).isZero(0)) continue;
      const Camera camera(with_parameters(zoom, parameters + kStep * root.col(k)));
      Eigen::VectorXd displacement(joint.rows());
      for (std::size_t i = 0; i < pairs_.size(); ++i) {
        const SquareFit fit = fit_one(pairs_[i], camera, &fits_[i]);
        displacement.segment<3>(static_cast<Eigen::Index>(3 * i)) =
            (point_of(fit.T_camera_marker, options_.offset_mm) -
             point_of(fits_[i].T_camera_marker, options_.offset_mm)) /
            kStep;
      }
      joint += displacement * displacement.transpose();
    }
  }

  std::vector<Pair> pairs_;
  Camera camera_;
  MarkerOptions options_;
  std::vector<SquareFit> fits_;
};

}  // namespace

MarkerSet locate_markers(const std::vector<DetectedMarker>& left,
                         const std::vector<DetectedMarker>& right,
                         const ZoomCalibration& calibration, const MarkerOptions& options) {
  check_twins(left, "left");
  check_twins(right, "right");
  MarkerSet set;
  const std::vector<Pair> pairs = paired(left, right, set.skipped);
  check_count(pairs.size(), !left.empty() || !right.empty(), set.skipped, options.least);
  Location(pairs, calibration, options).locate(set);
  return set;
}

Markups markups_of(const MarkerSet& set) {
  Markups markups;
  for (const LocatedMarker& marker : set.markers)
    markups.points.push_back(
        {fmt::format("aruco-{}", marker.id), marker.point_mm, marker.covariance_mm2,
         fmt::format("side {:.4f} mm, fit {:.4f} px", marker.side_mm, marker.fit_px)});
  markups.joint_covariance_mm2 = set.joint_covariance_mm2;
  return markups;
}

}  // namespace holdfast::registration
