// SPDX-License-Identifier: Apache-2.0
// Triangle surfaces and point clouds in files: PLY (ascii and binary little-endian in, binary
// little-endian out) and binary STL, mm.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

namespace holdfast::registration {

struct TriangleMesh {
  std::vector<Eigen::Vector3f> vertices_mm;
  std::vector<std::array<std::uint32_t, 3>> triangles;  ///< empty: a point cloud
  /// From `comment R1 r11 … r33`: the vertices are in the rectified frame, p = R1 · p_camera.
  std::optional<Eigen::Matrix3d> R_rectified_camera;
  std::vector<std::string> comments;  ///< the others, without the word `comment`
};

/// Reads PLY or STL by content. Throws InputError naming file and fault: unreadable, truncated, too
/// large (4 GiB, 10^8 elements), faces that are no triangles, an index out of range, a coordinate
/// that is not finite, no vertex.
[[nodiscard]] TriangleMesh read_mesh(const std::string& path);

/// The file's content; the caller writes it.
[[nodiscard]] std::string ply_bytes(const TriangleMesh& mesh);
[[nodiscard]] std::string stl_bytes(const TriangleMesh& mesh);

}  // namespace holdfast::registration
