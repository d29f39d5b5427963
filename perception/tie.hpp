// SPDX-License-Identifier: Apache-2.0
// How a keyframe taken later is tied to the first one: where its camera stood, how well that is
// known, and what becomes of both when a pose against it is told as one against the first. No
// state; any thread; allocation-free.
#pragma once

#include <Eigen/Geometry>

#include "perception/check_thread.hpp"
#include "perception/motion_estimate.hpp"

namespace holdfast::perception {

/// Poses and covariances are as MotionEstimate has them; a pose "since the first" is about the
/// first keyframe's pivot, one "since the tied" about the tied keyframe's own.
struct Tie {
  Eigen::Isometry3d T_tied_first = Eigen::Isometry3d::Identity();
  Matrix6d covariance = Matrix6d::Zero();  ///< about the first's pivot, axes of the tied camera
};

/// The same uncertainty told about a pivot that lies `by_mm` (camera axes) beside the former.
[[nodiscard]] Matrix6d about_other_pivot(const Matrix6d& covariance, const Eigen::Vector3d& by_mm);

/// Of the sum of two errors that may be correlated in whatever way: (1 + k) A + (1 + 1/k) B, which
/// bounds it for every k > 0; k weighs the two translations alike. The depth map's errors, and
/// those of one and the same image, enter a tie and what is measured against it alike: were the
/// two taken as independent, that would be divided away.
[[nodiscard]] Matrix6d bound_of_sum(const Matrix6d& a, const Matrix6d& b);

/// A pose since the tied keyframe, told since the first: its covariance contains the tie's.
[[nodiscard]] CheckedPose through(const Tie& tie, const CheckedPose& since_tied,
                                  const Eigen::Vector3d& p_pivot_tied_mm,
                                  const Eigen::Vector3d& p_pivot_first_mm);

/// The tie under which both poses of one image, since the tied keyframe and since the first, say
/// the same.
[[nodiscard]] Tie tie_between(const CheckedPose& since_tied, const CheckedPose& since_first,
                              const Eigen::Vector3d& p_pivot_tied_mm,
                              const Eigen::Vector3d& p_pivot_first_mm);

struct PoseDifference {
  double um = 0;     ///< at the pivot, in the image plane
  double sigma = 0;  ///< of all six freedoms that are known: square root of the normalised square
};
/// Of two poses since the first.
[[nodiscard]] PoseDifference between(const CheckedPose& a, const CheckedPose& b,
                                     const Eigen::Vector3d& p_pivot_first_mm);

/// The largest standard deviation of the translation in the image plane.
[[nodiscard]] double sigma_um(const Matrix6d& covariance);
/// The largest of the rotation about any axis.
[[nodiscard]] double rotation_sigma_rad(const Matrix6d& covariance);

}  // namespace holdfast::perception
