// SPDX-License-Identifier: Apache-2.0
// The closest point of a triangle surface, exactly, by a tree of boxes.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <vector>

#include <Eigen/Geometry>

#include "registration/mesh_file.hpp"

namespace holdfast::registration {

struct ClosestPoint {
  bool is_found = false;  ///< false: nothing within the search distance
  Eigen::Vector3d p_mm = Eigen::Vector3d::Zero();
  double distance_mm = std::numeric_limits<double>::infinity();
  std::uint32_t triangle = 0;
  /// The point lies on the surface's rim: what is beyond it was never measured.
  bool is_on_rim = false;
};

class TriangleTree {
 public:
  /// Copies what it needs. Triangles without area are left out; a mesh without others answers
  /// "nothing found". O(n log n).
  explicit TriangleTree(const TriangleMesh& mesh);

  /// Thread-safe; does not allocate. NaN in, nothing found.
  [[nodiscard]] ClosestPoint closest(
      const Eigen::Vector3d& p_mm,
      double within_mm = std::numeric_limits<double>::infinity()) const noexcept;

  /// Unit normal by the order of the triangle's corners (counter-clockwise from outside).
  [[nodiscard]] const Eigen::Vector3d& normal(std::uint32_t triangle) const {
    return normals_[triangle];
  }
  [[nodiscard]] std::size_t size() const noexcept { return leaves_.size(); }

 private:
  struct Leaf {  // one triangle
    Eigen::Vector3d a, b, c;
    std::uint32_t triangle;
    std::uint8_t rim;  // bits 0..2: edges ab, bc, ca; bits 3..5: corners a, b, c
  };
  struct Node {
    Eigen::AlignedBox3f box;
    std::uint32_t first, count;  // count 0: inner node, children at first and first + 1
  };
  void mark_rim(const TriangleMesh& mesh);
  void build(std::uint32_t node, std::uint32_t first, std::uint32_t count);
  std::vector<Leaf> leaves_;
  std::vector<Node> nodes_;
  std::vector<Eigen::Vector3d> normals_;  // by the mesh's triangle index
};

}  // namespace holdfast::registration
