// SPDX-License-Identifier: Apache-2.0
// A fiducial registration and a reconstructed surface, fused by covariance. The surface does not
// overwrite the fiducials: each adds the information it has. The surface's errors are not
// independent from point to point: calibration bends it as a whole. So a random field is
// part of the error model, and a thousand neighbours count little more than one. What the
// calibration does to fiducials and surface alike (RigidFit::common_covariance) neither can tell,
// and it stays in the result as it was. Steep places and the ragged ends of what was reconstructed
// do not vote: near depth edges a matcher errs to one side.
#pragma once

#include <cstdint>
#include <vector>

#include "registration/rigid_fit.hpp"
#include "registration/triangle_tree.hpp"

namespace holdfast::registration {

struct SurfaceFitOptions {
  std::size_t points = 4000;  ///< drawn from the surface
  std::uint64_t seed = 1;
  double within_mm = 2;  ///< farther from the CT surface is not overlap
  double patch_mm = 4;   ///< points are averaged over pieces of this size
  /// The calibration's error bends the surface as a field of correlation exp(-d / L). A smoother
  /// kernel would let the fit tell field from motion far better than any real error allows.
  double correlation_mm = 10;  ///< L
  /// 1 sigma of it, at least: what calibration and the matcher's habits at steep slopes leave and
  /// residuals do not show. Rendered ears against the truth: at 0.06 mm their region was too small.
  double field_min_mm = 0.1;
  /// 1 sigma of how far the CT's surface lies off along its normal, everywhere alike: its
  /// threshold, partial volume and blur decide that.
  double offset_mm = 0.05;
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
  double noise_mm = 0;                                            ///< 1 sigma of a point
  double field_mm = 0;  ///< 1 sigma of the field, as seen or as at least assumed
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
