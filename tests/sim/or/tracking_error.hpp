// SPDX-License-Identifier: Apache-2.0
// A tracker's trajectory against how the site truly moved.
#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include <Eigen/Geometry>

#include "tests/sim/trajectory.hpp"

namespace holdfast::sim {

struct TrackingError {
  int frames = 0, lost = 0;  ///< rows but the keyframe's; of them without a pose
  /// Paper B, Eq. 6-7: of two frames in turn that both have a pose, in the image plane.
  double step_mean_um = 0, step_sd_um = 0;
  double absolute_rms_um = 0, absolute_max_um = 0;  ///< since the keyframe, in the image plane
  double depth_rms_um = 0, rotation_rms_mrad = 0;
  int silently_wrong = 0;  ///< `tracking` or `relocalised`, and more than 200 um off
  std::string rows;  ///< CSV, one row a frame with a pose: reference and errors; the rotation's
                     ///< also as a vector, fixed camera axes
};

/// `poses`: poses.csv of `holdfast track`, its first row the keyframe's. `T_camera_ideal`: from the
/// frame that `truth` is told in to that of the tracker's calibration. Judged at `p_site_mm`, or
/// without one at the point of the optical axis at `depth_mm`. Figures of nothing are NaN. Throws
/// InputError for a file that is none.
[[nodiscard]] TrackingError tracking_error(const std::filesystem::path& poses,
                                           const Trajectory& truth,
                                           const Eigen::Isometry3d& T_camera_ideal, double depth_mm,
                                           const std::optional<Eigen::Vector3d>& p_site_mm = {});

}  // namespace holdfast::sim
