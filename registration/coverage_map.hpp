// SPDX-License-Identifier: Apache-2.0
// Which parts of the CT's surface a reconstruction has covered, and why it has not covered the
// others. Everything is told from the files of the pipeline: the two surfaces, the registration,
// the cameras as the reconstruction's file describes them and, where it is given, the
// reconstruction's own account of each pixel.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "registration/mesh_file.hpp"
#include "registration/pixel_reason.hpp"

namespace holdfast::registration {

/// What is said of a triangle of the CT.
enum class Coverage : std::uint8_t {
  outside_view,  ///< of a camera, of the region or of the depths that were searched
  facing_away,   ///< from a camera
  occluded,      ///< the CT's own surface hides it from a camera
  steep,         ///< seen at so flat an angle that it was not matched
  unmatched,
  uncertain,
  repeating,
  disagrees,  ///< something was reconstructed in its place, elsewhere
  covered
};
inline constexpr std::size_t kCoverages = 9;
[[nodiscard]] std::string_view name(Coverage coverage) noexcept;

/// The rectified pair that a surface was reconstructed from: what its file says of it.
struct ReconstructedView {
  cv::Size size_px;     ///< of both rectified images
  cv::Rect region_px;   ///< of the left one
  double focal_px = 0;  ///< square pixels, the same in both
  double cx_px = 0, cy_px = 0, cx_right_px = 0;
  double baseline_mm = 0;
  double nearest_mm = 0, farthest_mm = 0;  ///< depths that were searched

  [[nodiscard]] std::string comment() const;
};
/// From the mesh's comment; empty where none says it. Throws InputError on one that is broken.
[[nodiscard]] std::optional<ReconstructedView> view_of(const TriangleMesh& mesh);

struct CoverageOptions {
  double agree_mm = 1;       ///< farther from the reconstructed surface: not covered
  double hidden_mm = 1;      ///< behind another part of the CT by more: occluded
  double facing_min = 0.35;  ///< cosine to the line of sight; less is steep
};

struct CoverageMap {
  std::vector<Coverage> triangles;  ///< of the CT's mesh, in its order
  std::vector<float> distance_mm;   ///< to the reconstruction; NaN where not covered
  std::array<double, kCoverages> area_mm2{};
  double visible_mm2 = 0;    ///< all but outside_view, facing_away and occluded
  double covered_share = 0;  ///< of visible_mm2
  double agreement_mean_mm = 0, agreement_rms_mm = 0;  ///< by area, over what is covered
};

/// `ct` in frame ct (triangles counter-clockwise from outside), `surface` in frame camera or
/// rectified with its R1, with triangles. `reasons`: PixelReason on the rectified left grid of
/// view.size_px; empty: what is not known counts as unmatched.
[[nodiscard]] CoverageMap coverage_map(const TriangleMesh& ct, const Eigen::Isometry3d& T_camera_ct,
                                       const TriangleMesh& surface, const ReconstructedView& view,
                                       const cv::Mat1b& reasons, const CoverageOptions& options);

/// The CT's mesh as PLY, each face with `red green blue` and its Coverage as `coverage`; without
/// the faces that are outside the view.
[[nodiscard]] std::string coverage_ply(const TriangleMesh& ct, const CoverageMap& map);

}  // namespace holdfast::registration
