// SPDX-License-Identifier: Apache-2.0
// Takes parts of a triangle mesh away; vertices that no triangle has any more go with them, and
// what stays keeps its order.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include <Eigen/Geometry>

#include "registration/mesh_file.hpp"

namespace holdfast::registration {

using MeshEdges = std::vector<std::array<std::uint32_t, 2>>;  ///< pairs of vertices

/// The two ends of each edge become one vertex (one of the two), and the triangles that had the
/// edge vanish: a closed surface stays closed.
void collapse_edges(const MeshEdges& edges, TriangleMesh& mesh);

/// Keeps the triangles with all corners in the box.
void keep_inside(const Eigen::AlignedBox3f& box_mm, TriangleMesh& mesh);

/// Keeps the connected piece (by shared vertices) with the most triangles.
void keep_largest_piece(TriangleMesh& mesh);

}  // namespace holdfast::registration
