// SPDX-License-Identifier: Apache-2.0
// A fiducial registration and a reconstructed surface, fused by covariance. The surface does not
// overwrite the fiducials: each adds the information it has. The surface's errors are not
// independent from point to point (calibration bends whole regions), so points share a regional
// error, and a thousand neighbours count little more than one.
#pragma once

#include <cstdint>
#include <vector>

#include "registration/rigid_fit.hpp"
#include "registration/triangle_tree.hpp"

namespace holdfast::registration {

struct SurfaceFitOptions {
  std::size_t points = 4000;  ///< drawn from the surface
  std::uint64_t seed = 1;
  double within_mm = 2;   ///< farther from the CT surface is not overlap
  double region_mm = 10;  ///< size of the regions that share an error
  double regional_min_mm =
      0.03;                  ///< 1 sigma of that error, at least: what a good calibration leaves
  double overlap_min = 0.3;  ///< share of the drawn points that must lie on the CT surface
  double disagreement_p_min = 1e-4;
};

enum class SurfaceFitStatus {
  fused,
  no_overlap,    ///< fewer points than overlap_min lie on the CT surface
  disagreement,  ///< surface and fiducials contradict each other beyond their covariances
  not_converged
};

struct SurfaceFit {
  SurfaceFitStatus status = SurfaceFitStatus::not_converged;
  Eigen::Isometry3d T_camera_ct = Eigen::Isometry3d::Identity();  ///< only with `fused`
  Matrix6d covariance = Matrix6d::Zero();                         ///< as RigidFit::covariance
  double overlap = 0;                                             ///< share of the drawn points
  double noise_mm = 0;     ///< 1 sigma of a point about its region's error
  double regional_mm = 0;  ///< 1 sigma of a region's error, as seen or as at least assumed
  double closest_point_mean_mm = 0, closest_point_rmse_mm = 0;  ///< over the overlap
  double shift_mm = 0;  ///< how far the overlap's centre moved from the fiducials' fit
  double p_value = 1;   ///< of a disagreement at least as large
};

/// `start` must be FitStatus::fitted. `p_camera_mm`: the reconstructed surface's points in frame
/// camera. `ct`: the CT surface, frame ct. Pure: same seed, same result.
[[nodiscard]] SurfaceFit fuse_surface(const RigidFit& start,
                                      const std::vector<Eigen::Vector3d>& p_camera_mm,
                                      const TriangleTree& ct, const SurfaceFitOptions& options);

}  // namespace holdfast::registration
