// SPDX-License-Identifier: Apache-2.0
// Part of isosurface: marching cubes by whole rows of voxels, after flying edges (Schroeder,
// Maynard and Geveci, 2015). Which voxels reach iso is one bit each; edges that cross the surface,
// cells that hold some of it and the numbers of the vertices all follow from these bits by words
// of 64.
#pragma once

#include <Eigen/Geometry>

#include "registration/ct/ct_volume.hpp"
#include "registration/mesh_file.hpp"

namespace holdfast::registration {

/// The surface where the HU cross `iso_hu` (-32767 to 32767) between the voxels of `box` (indices,
/// both ends included, at least two along each axis), in frame ct, closed but where it leaves the
/// box; empty where there is none. A vertex keeps 1/1000 of its edge away from both ends, so that a
/// voxel of exactly iso makes no triangle without extent. Triangles turn counter-clockwise seen
/// from the side of lower HU where the index axes are right-handed; `is_turned` turns them round.
/// The same on any number of threads. Throws RefusedError at more than 2^32 vertices.
[[nodiscard]] TriangleMesh bit_cubes(const CtVolume& volume, const Eigen::AlignedBox<int, 3>& box,
                                     double iso_hu, bool is_turned, int threads);

}  // namespace holdfast::registration
