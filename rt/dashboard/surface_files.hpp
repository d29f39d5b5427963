// SPDX-License-Identifier: Apache-2.0
// The surfaces of the page's 3D view, from files named at the start: read strictly, brought into
// one frame (camera at the keyframe, mm), and packed for the page. Any thread; allocates.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace holdfast::dashboard {

struct SurfaceFiles {
  std::filesystem::path ct;              ///< PLY or STL, patient LPS, mm
  std::filesystem::path reconstruction;  ///< MiRe, rectified left or camera frame, mm
  std::filesystem::path registration;    ///< registration.json; needed for `ct`
};

/// One surface as the page reads it, all little-endian: "HFM1", then as uint32 the numbers of
/// vertices and of triangles and whether there are distances (0, 1); float32 x, y, z of each
/// vertex; with distances a float32 for each; three uint32 for each triangle.
struct PackedSurface {
  std::string name;  ///< "ct", "reconstruction"
  std::string bytes;
};

/// The reconstruction carries each vertex' distance to the CT's triangles (mm; NaN beyond
/// kHeatMapMaxMm), when both are given. Throws InputError on a file that cannot be used, on `ct`
/// without `registration`, and on more than kTrianglesMax triangles.
[[nodiscard]] std::vector<PackedSurface> read_surfaces(const SurfaceFiles& files);

inline constexpr double kHeatMapMaxMm = 5;
inline constexpr std::size_t kTrianglesMax = 3'000'000;

}  // namespace holdfast::dashboard
