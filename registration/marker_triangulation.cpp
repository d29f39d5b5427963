// SPDX-License-Identifier: Apache-2.0
#include "registration/marker_triangulation.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <Eigen/Cholesky>
#include <fmt/format.h>

#include "registration/marker_square.hpp"
#include "registration/working_volume.hpp"
#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

using marker::SquareFit;

Eigen::Vector3d point_of(const Eigen::Isometry3d& T_camera_marker, double offset_mm) {
  return T_camera_marker * Eigen::Vector3d(0, 0, -offset_mm);
}

void check_twins(const std::vector<DetectedMarker>& markers, const char* side) {
  for (std::size_t i = 1; i < markers.size(); ++i)
    if (markers[i].id == markers[i - 1].id)
      throw RefusedError(fmt::format("aruco-{} is twice in the {} image", markers[i].id, side));
}

std::vector<marker::Sighting> paired(const std::vector<DetectedMarker>& left,
                                     const std::vector<DetectedMarker>& right,
                                     std::vector<std::string>& skipped) {
  std::vector<marker::Sighting> pairs;
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

class Location {
 public:
  Location(std::vector<marker::Sighting> pairs, const ZoomCalibration& calibration,
           const MarkerOptions& options)
      : pairs_(std::move(pairs)), calibration_(calibration), options_(options) {
    if (options.marker_mm > 0) side_ = {options.marker_mm, options.marker_sigma_mm};
    for (const marker::Sighting& pair : pairs_)
      information_.push_back(
          marker::information_of(pair, side_, std::min(calibration.rms_px, kLargestMisfitPx)));
  }

  void locate(MarkerSet& set) {
    fit_all(calibration_);
    for (std::size_t i = 0; i < pairs_.size(); ++i)
      check_marker(located(i), options_, calibration_.focus_mm);
    const auto size = static_cast<Eigen::Index>(3 * pairs_.size());
    set.joint_covariance_mm2 = Eigen::MatrixXd::Zero(size, size);
    set.calibration = calibration_;
    if (calibration_.parameter_covariance.size() > 0) seat(set);
    for (std::size_t i = 0; i < pairs_.size(); ++i) {
      const auto at = static_cast<Eigen::Index>(3 * i);
      set.joint_covariance_mm2.block<3, 3>(at, at) += image_covariance(fits_[i]);
      LocatedMarker marker = located(i);
      marker.covariance_mm2 = set.joint_covariance_mm2.block<3, 3>(at, at);
      set.markers.push_back(marker);
    }
  }

 private:
  /// Of a board's residual, no more than this is taken for the lens's: the rest is its corners'.
  static constexpr double kLargestMisfitPx = 0.02;

  void fit_all(const ZoomCalibration& calibration) {
    const marker::Camera camera(calibration);
    std::vector<SquareFit> fits;
    for (std::size_t i = 0; i < pairs_.size(); ++i)
      fits.push_back(marker::fit_square(pairs_[i], side_, information_[i], camera,
                                        fits_.empty() ? nullptr : &fits_[i]));
    fits_ = fits;
  }

  [[nodiscard]] LocatedMarker located(std::size_t i) const {
    LocatedMarker marker;
    marker.id = pairs_[i].left->id;
    marker.T_camera_marker = fits_[i].T_camera_marker;
    marker.side_mm = fits_[i].side_mm;
    marker.fit_px = fits_[i].rms_px;
    marker.point_mm = point_of(fits_[i].T_camera_marker, options_.offset_mm);
    return marker;
  }

  /// The corners' covariance, raised where the square fits them worse than it says.
  [[nodiscard]] Eigen::Matrix3d image_covariance(const SquareFit& fit) const {
    Eigen::Matrix<double, 3, 7> jacobian;
    const Eigen::Vector3d here = point_of(fit.T_camera_marker, options_.offset_mm);
    for (Eigen::Index k = 0; k < 7; ++k) {
      marker::Square step = marker::Square::Zero();
      step[k] = 1e-5;
      jacobian.col(k) =
          (point_of(marker::moved(fit.T_camera_marker, step), options_.offset_mm) - here) / 1e-5;
    }
    constexpr double kTypicalPx = 0.03;
    const double excess = std::max(1.0, std::pow(fit.rms_px / kTypicalPx, 2));
    return excess * jacobian * fit.covariance * jacobian.transpose() + made_covariance(fit);
  }

  [[nodiscard]] Eigen::Matrix3d made_covariance(const SquareFit& fit) const {
    if (options_.offset_mm == 0) return Eigen::Matrix3d::Zero();
    const Eigen::Matrix3d R = fit.T_camera_marker.linear();
    return R * options_.offset_sigma_mm.cwiseAbs2().asDiagonal() * R.transpose();
  }

  /// All markers share one calibration, whose error has a known covariance, and tell something of
  /// it: that lines of sight meet, that squares are square, and of which side. Its most probable
  /// value moves all of them; what stays unknown is their common covariance. Linear: the change is
  /// small. The markers' own places are eliminated by fitting each anew for every change.
  void seat(MarkerSet& set) {
    const Eigen::MatrixXd root = covariance_root(calibration_.parameter_covariance);
    const Eigen::VectorXd parameters = parameter_vector(calibration_);
    const auto count = static_cast<Eigen::Index>(pairs_.size());
    Eigen::MatrixXd moves = Eigen::MatrixXd::Zero(3 * count, root.cols());
    Eigen::MatrixXd residuals = Eigen::MatrixXd::Zero(17 * count, root.cols());
    constexpr double kStep = 0.1;  // of a standard deviation
    for (Eigen::Index k = 0; k < root.cols(); ++k) {
      if (root.col(k).isZero(0)) continue;
      const marker::Camera camera(with_parameters(calibration_, parameters + kStep * root.col(k)));
      for (std::size_t i = 0; i < pairs_.size(); ++i) {
        const auto at = static_cast<Eigen::Index>(i);
        const SquareFit fit =
            marker::fit_square(pairs_[i], side_, information_[i], camera, &fits_[i]);
        moves.block<3, 1>(3 * at, k) = (point_of(fit.T_camera_marker, options_.offset_mm) -
                                        point_of(fits_[i].T_camera_marker, options_.offset_mm)) /
                                       kStep;
        residuals.block<17, 1>(17 * at, k) = (fit.residual - fits_[i].residual) / kStep;
      }
    }
    Eigen::MatrixXd normal = Eigen::MatrixXd::Identity(root.cols(), root.cols());
    Eigen::VectorXd right = Eigen::VectorXd::Zero(root.cols());
    for (std::size_t i = 0; i < pairs_.size(); ++i) {
      const auto change = residuals.middleRows<17>(17 * static_cast<Eigen::Index>(i));
      normal += change.transpose() * information_[i] * change;
      right -= change.transpose() * information_[i] * fits_[i].residual;
    }
    const Eigen::MatrixXd posterior =
        normal.ldlt().solve(Eigen::MatrixXd::Identity(root.cols(), root.cols()));
    set.calibration = with_parameters(calibration_, parameters + root * (posterior * right));
    set.calibration.parameter_covariance = root * posterior * root.transpose();
    set.joint_covariance_mm2 = moves * posterior * moves.transpose();
    fit_all(set.calibration);
  }

  std::vector<marker::Sighting> pairs_;
  const ZoomCalibration& calibration_;
  MarkerOptions options_;
  marker::KnownSide side_;
  std::vector<Eigen::Matrix<double, 17, 17>> information_;
  std::vector<SquareFit> fits_;
};

}  // namespace

MarkerSet locate_markers(const std::vector<DetectedMarker>& left,
                         const std::vector<DetectedMarker>& right,
                         const ZoomCalibration& calibration, const MarkerOptions& options) {
  check_twins(left, "left");
  check_twins(right, "right");
  MarkerSet set;
  const std::vector<marker::Sighting> pairs = paired(left, right, set.skipped);
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
