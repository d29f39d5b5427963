// SPDX-License-Identifier: Apache-2.0
// The nearest depth of a triangle mesh in every cell of a pinhole camera's image.
#pragma once

#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "registration/mesh_file.hpp"

namespace holdfast::registration {

/// A camera at (centre_x_mm, 0, 0) that looks along z; cells of `cell_px` pixels.
struct RasterCamera {
  double focal_px = 1, cx_px = 0, cy_px = 0, centre_x_mm = 0;
  cv::Size size_px;
  int cell_px = 1;

  /// Of a point in front of it; column and row of the cell, not rounded.
  [[nodiscard]] Eigen::Vector2d cell_of(const Eigen::Vector3d& p_mm) const;
};

/// Depth at the middle of each cell, mm; NaN where no triangle is. Triangles that reach behind the
/// camera are left out.
[[nodiscard]] cv::Mat1f raster_depth(const std::vector<Eigen::Vector3d>& vertices_mm,
                                     const std::vector<std::array<std::uint32_t, 3>>& triangles,
                                     const RasterCamera& camera);

}  // namespace holdfast::registration
