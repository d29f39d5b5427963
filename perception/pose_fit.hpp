// SPDX-License-Identifier: Apache-2.0
// Fits T_camera_site to points of the site and where they are seen: consensus by random samples
// (RANSAC), then robust Gauss-Newton on the reprojection error, with an honest covariance.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include <Eigen/Geometry>

#include "perception/motion_estimate.hpp"

namespace holdfast::perception {

/// One point of the site and where the camera sees it, undistorted, in pixels from the principal
/// point: seen = f * (x/z, y/z).
struct Observation {
  Eigen::Vector3d p_site_mm;
  Eigen::Vector2d seen_px;
};
using Observations = std::vector<Observation>;

/// Which motions are possible.
enum class Freedom : std::uint8_t {
  planar,  ///< x, y, z and rotation about z: a plane facing the camera
  rigid    ///< all six
};

struct FitSetup {
  double f_px = 0;  ///< the focal length that `seen_px` is scaled with
  Freedom freedom = Freedom::planar;
  Eigen::Vector3d p_pivot_site_mm = Eigen::Vector3d::Zero();
};

struct PoseFit {
  Eigen::Isometry3d T_camera_site = Eigen::Isometry3d::Identity();
  std::vector<int> inliers;  ///< indices into the observations, ascending
  double rms_px = 0;         ///< of the inliers
  /// As MotionEstimate::covariance, of independent errors only and for unit variance: multiply by
  /// the variance of one coordinate (px^2). Rows and columns of fixed freedoms are zero.
  Matrix6d unit_covariance = Matrix6d::Zero();
  double sigma_px = 0;  ///< robust sigma of one coordinate of an inlier
};

/// Distance in px between where the point is seen and where the pose puts it; infinite behind the
/// camera.
[[nodiscard]] double reprojection_error_px(const Observation& observation,
                                           const Eigen::Isometry3d& T_camera_site, double f_px);

struct ConsensusParameters {
  std::uint32_t seed = 1;
  int iterations = 300;
  double threshold_px = 4;
  double parallax_px = 40;  ///< rigid: tolerated in the planar consensus that comes first
  int inliers_min = 8;
};

/// The motion most observations agree on; nothing when fewer than inliers_min do. For a rigid fit a
/// planar consensus with a wide threshold comes first and seeds samples of four points.
[[nodiscard]] std::optional<PoseFit> find_consensus(const Observations& observations,
                                                    const FitSetup& setup,
                                                    const ConsensusParameters& parameters);

/// Robust refinement (Tukey) from `T_start`, over all observations. Inliers are those within
/// `threshold_px` at the end. Nothing when the observations do not determine the motion.
[[nodiscard]] std::optional<PoseFit> refine(const Observations& observations, const FitSetup& setup,
                                            const Eigen::Isometry3d& T_start, double threshold_px);

}  // namespace holdfast::perception
