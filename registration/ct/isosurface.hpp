// SPDX-License-Identifier: Apache-2.0
// The surface of equal HU in a CT volume, in patient coordinates (VTK's flying edges).
#pragma once

#include <optional>

#include <Eigen/Geometry>

#include "registration/ct/ct_volume.hpp"
#include "registration/mesh_file.hpp"

namespace holdfast::registration {

struct IsosurfaceOptions {
  double iso_hu = 0;
  /// Only triangles with all corners in this box (frame ct, mm) are kept.
  std::optional<Eigen::AlignedBox3d> roi_mm;
  bool is_largest_only = false;  ///< keep only the connected piece with the most triangles
  int threads = 2;
};

/// Vertices in frame ct; each triangle turns counter-clockwise seen from the side of lower HU, so
/// its normal points out of the denser body, whatever the handedness of the index axes. Throws
/// RefusedError when there is no surface: iso outside the volume's range, ROI outside or empty.
[[nodiscard]] TriangleMesh isosurface(const CtVolume& volume, const IsosurfaceOptions& options);

}  // namespace holdfast::registration
