// SPDX-License-Identifier: Apache-2.0
// Paper A's marker holders: a plastic block with an ArUco marker on its inclined top and a metal
// bead inside, just below the marker.
#pragma once

#include "tests/sim/or/phantom.hpp"

namespace holdfast::sim {

inline constexpr double kMarkerSideMm = 8.0;  ///< of the black square, as designed
/// How exactly it is made: plotted on film and measured, not printed on paper.
inline constexpr double kMarkerSideSigmaMm = 0.002;
inline constexpr double kHolderSideMm = 32. / 3;  ///< of the block: a white border of one cell
inline constexpr double kBeadDiameterMm = 1.5;
inline constexpr double kBeadDepthMm = 1.0;  ///< of its centre below the marker, as designed

struct MarkerHolder {
  TrueMarker marker;
  double length_mm = 0;  ///< of the block below the marker
};

/// Distance to the block, negative inside; exact.
[[nodiscard]] float holder_distance(const MarkerHolder& holder, const Eigen::Vector3f& p_ct);

/// The top with the printed marker, and the block's other faces.
[[nodiscard]] LitSurface marker_surface(const MarkerHolder& holder);
[[nodiscard]] LitSurface block_surface(const MarkerHolder& holder, const Look& look);

/// A box with flat faces, centred on the frame's origin; without its +z face where `is_open`.
[[nodiscard]] LitSurface box_surface(const Eigen::Isometry3d& T_ct_box,
                                     const Eigen::Vector3d& half_sizes_mm, bool is_open);

}  // namespace holdfast::sim
