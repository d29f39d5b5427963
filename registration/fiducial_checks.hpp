// SPDX-License-Identifier: Apache-2.0
// Which CT fiducial is which marker, and whether one of them is not where the others say it should
// be. Pure, re-entrant; allocates.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "registration/rigid_fit.hpp"

namespace holdfast::registration {

enum class CorrespondenceStatus { found, none, ambiguous, too_many };

struct Correspondence {
  CorrespondenceStatus status = CorrespondenceStatus::none;
  /// For each moving point the index of its fixed point. Only with CorrespondenceStatus::found.
  std::vector<std::size_t> fixed_of_moving;
  double fre_mm = 0;         ///< of the best assignment; infinite where there is none
  double second_fre_mm = 0;  ///< of the next best; infinite where there is none
  /// With `ambiguous`: the assignments that would be accepted, the best one first, 64 at most.
  std::vector<std::vector<std::size_t>> candidates;
  std::size_t candidate_count = 0;  ///< all of them
};

/// Finds the assignment of every moving point to its own fixed point that a proper rigid motion
/// explains with an FRE of at most `fre_max_mm`; fixed points may be left over. `ambiguous` when a
/// second assignment would be accepted as well (all are then given: a caller that knows the points'
/// errors may still tell them apart), `none` when not even one, `too_many` beyond 16 moving
/// or 64 fixed points.
[[nodiscard]] Correspondence find_correspondence(const std::vector<Eigen::Vector3d>& fixed_mm,
                                                 const std::vector<Eigen::Vector3d>& moving_mm,
                                                 double fre_max_mm);

/// What the other fiducials say about one of them.
struct LeftOut {
  std::string label;
  double displacement_mm = 0;  ///< distance between it and where the others predict it
  double p_value = 1;          ///< of a displacement at least as unlikely, were all of them true
};

/// The leave-one-out prediction of each fiducial under the fit's error model (generalised least
/// squares, so also with a joint covariance). Empty with fewer than four pairs, and for a fit that
/// is not FitStatus::fitted.
[[nodiscard]] std::vector<LeftOut> leave_one_out(const FiducialSet& fiducials, const RigidFit& fit);

/// The FRE of the best improper motion (a reflection): below the proper one's it tells of a
/// mirrored CT. Points that lie in a plane fit both.
[[nodiscard]] double mirrored_fre_mm(const FiducialSet& fiducials);

}  // namespace holdfast::registration
