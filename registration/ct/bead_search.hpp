// SPDX-License-Identifier: Apache-2.0
// All beads of one diameter in a CT: bright pieces of about the right size, each fitted as a ball,
// and what is none (bone, wires, dental fillings) rejected by size, shape, contrast and residual.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "registration/ct/bead_fit.hpp"
#include "registration/markups.hpp"

namespace holdfast::registration {

struct RejectedBead {
  Eigen::Vector3d p_ct_mm;
  std::string reason;
};

struct BeadSearch {
  std::vector<BeadFit> beads;          ///< ascending in x, then y, then z
  std::vector<RejectedBead> rejected;  ///< of about the right size, but no bead
};

/// Throws InputError for a diameter outside 0.5 to 10 mm, RefusedError for voxels larger than the
/// bead's diameter.
[[nodiscard]] BeadSearch find_beads(const CtVolume& volume, double diameter_mm);

/// The beads as points `bead-1` … with covariance, contrast and sphericity. Throws RefusedError,
/// naming what was found and rejected: none, or not `expected` many.
[[nodiscard]] std::vector<MarkupPoint> bead_points(const BeadSearch& search,
                                                   std::optional<int> expected);

}  // namespace holdfast::registration
