// SPDX-License-Identifier: Apache-2.0
// The centre of one bead from the voxels about it: a ball of known diameter, blurred by the scanner
// (differently along the slices' normal), on a background that may end at one flat side nearby, as
// under a marker's face. Values at the scanner's limits are modelled as clipped.
#pragma once

#include <array>
#include <string>

#include <Eigen/Core>

#include "registration/ct/ct_volume.hpp"

namespace holdfast::registration {

struct BeadFit {
  Eigen::Vector3d p_ct_mm = Eigen::Vector3d::Zero();
  /// Of the centre: from the fit's residuals, inflated for the noise's correlation between voxels,
  /// plus (0.01 mm)² for what the model leaves out.
  Eigen::Matrix3d covariance_mm2 = Eigen::Matrix3d::Zero();
  double contrast_hu = 0;  ///< ball against its surroundings, as far as not clipped
  double background_hu = 0;
  double blur_mm = 0;         ///< standard deviation in the slices' plane
  double elongation = 1;      ///< of ball and blur along the slices' normal
  double residual_share = 1;  ///< rms residual over the contrast
  double sphericity = 0;      ///< shortest over longest axis of what is bright; 1 for a ball
  bool is_clipped = false;
  bool has_converged = false;
};

/// `p_start_ct_mm`: within a radius of the centre. Never throws; what does not fit says so by
/// has_converged and residual_share.
[[nodiscard]] BeadFit fit_bead(const CtVolume& volume, const Eigen::Vector3d& p_start_ct_mm,
                               double diameter_mm, int highest_hu);

}  // namespace holdfast::registration
