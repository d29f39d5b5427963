// SPDX-License-Identifier: Apache-2.0
#include "registration/coverage_map.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <sstream>

#include <fmt/format.h>

#include "registration/depth_raster.hpp"
#include "registration/triangle_tree.hpp"
#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

constexpr const char* kViewComment = "rectified_view";
constexpr int kCellsAcross = 800;

std::vector<Eigen::Vector3d> in_rectified(const TriangleMesh& mesh,
                                          const Eigen::Isometry3d& T_rectified_mesh) {
  std::vector<Eigen::Vector3d> points;
  points.reserve(mesh.vertices_mm.size());
  for (const Eigen::Vector3f& v : mesh.vertices_mm)
    points.emplace_back(T_rectified_mesh * v.cast<double>());
  return points;
}

/// A triangle as the judge asks of it, rectified frame.
struct Facet {
  Eigen::Vector3d centre_mm, n;
  double area_mm2;
};

Facet facet_of(const std::vector<Eigen::Vector3d>& vertices,
               const std::array<std::uint32_t, 3>& corners) {
  const Eigen::Vector3d &a = vertices[corners[0]], &b = vertices[corners[1]],
                        &c = vertices[corners[2]];
  const Eigen::Vector3d cross = (b - a).cross(c - a);
  const double length = cross.norm();
  const Eigen::Vector3d n = length > 0 ? Eigen::Vector3d{cross / length} : Eigen::Vector3d::Zero();
  return {(a + b + c) / 3, n, 0.5 * length};
}

class Judge {
 public:
  Judge(const std::vector<Eigen::Vector3d>& ct, const TriangleMesh& ct_mesh,
        const TriangleMesh& surface, const ReconstructedView& view, const cv::Mat1b& reasons,
        const CoverageOptions& options)
      : view_(view),
        reasons_(reasons),
        options_(options),
        left_{view.focal_px, view.cx_px,
              view.cy_px,    0,
              view.size_px,  std::max(1, view.size_px.width / kCellsAcross)},
        right_(left_),
        tree_(surface) {
    right_.cx_px = view.cx_right_px;
    right_.centre_x_mm = view.baseline_mm;
    left_depth_ = raster_depth(ct, ct_mesh.triangles, left_);
    right_depth_ = raster_depth(ct, ct_mesh.triangles, right_);
    found_depth_ = raster_depth(in_rectified(surface, Eigen::Isometry3d::Identity()),
                                surface.triangles, left_);
  }

  /// `distance_mm` is set where the facet is covered.
  [[nodiscard]] Coverage judge(const Facet& facet, float& distance_mm) const {
    const Eigen::Vector3d& p = facet.centre_mm;
    if (!(p.z() >= view_.nearest_mm && p.z() <= view_.farthest_mm)) return Coverage::outside_view;
    const Eigen::Vector2d seen = pixel(left_, p), seen_right = pixel(right_, p);
    const cv::Point at(static_cast<int>(std::lround(seen.x())),
                       static_cast<int>(std::lround(seen.y())));
    if (!view_.region_px.contains(at) || seen_right.x() < 0 ||
        seen_right.x() > view_.size_px.width - 1)
      return Coverage::outside_view;
    const Eigen::Vector3d from_right = p - Eigen::Vector3d(view_.baseline_mm, 0, 0);
    const double facing =
        std::min(-facet.n.dot(p.normalized()), -facet.n.dot(from_right.normalized()));
    if (facing <= 0) return Coverage::facing_away;
    if (is_hidden(left_depth_, left_, p) || is_hidden(right_depth_, right_, p))
      return Coverage::occluded;
    const ClosestPoint closest = tree_.closest(p, options_.agree_mm);
    if (closest.is_found && !closest.is_on_rim) {
      distance_mm = static_cast<float>(closest.distance_mm);
      return Coverage::covered;
    }
    // Near the reconstruction's rim nothing is measured, and nothing contradicts.
    if (!closest.is_found && is_known(p)) return Coverage::disagrees;
    return facing < options_.facing_min ? Coverage::steep : reason_at(at);
  }

 private:
  static Eigen::Vector2d pixel(const RasterCamera& camera, const Eigen::Vector3d& p) {
    RasterCamera whole = camera;
    whole.cell_px = 1;
    return whole.cell_of(p);
  }
  static float value(const cv::Mat1f& depth, const RasterCamera& camera, const Eigen::Vector3d& p) {
    const Eigen::Vector2d cell = camera.cell_of(p);
    const int x = std::clamp(static_cast<int>(std::lround(cell.x())), 0, depth.cols - 1),
              y = std::clamp(static_cast<int>(std::lround(cell.y())), 0, depth.rows - 1);
    return depth(y, x);
  }
  [[nodiscard]] bool is_hidden(const cv::Mat1f& depth, const RasterCamera& camera,
                               const Eigen::Vector3d& p) const {
    return static_cast<double>(value(depth, camera, p)) < p.z() - options_.hidden_mm;
  }
  /// Something was reconstructed along the line of sight.
  [[nodiscard]] bool is_known(const Eigen::Vector3d& p) const {
    return !std::isnan(value(found_depth_, left_, p));
  }
  [[nodiscard]] Coverage reason_at(cv::Point at) const {
    if (reasons_.empty()) return Coverage::unmatched;
    switch (static_cast<PixelReason>(reasons_(at))) {
      case PixelReason::outside:
        return Coverage::outside_view;
      case PixelReason::uncertain:
        return Coverage::uncertain;
      case PixelReason::repeating:
        return Coverage::repeating;
      case PixelReason::known:  // and not in the mesh: a depth edge runs here
      case PixelReason::unmatched:
        break;
    }
    return Coverage::unmatched;
  }

  const ReconstructedView& view_;
  const cv::Mat1b& reasons_;
  const CoverageOptions& options_;
  RasterCamera left_, right_;
  TriangleTree tree_;
  cv::Mat1f left_depth_, right_depth_, found_depth_;
};

void summarise(const std::vector<Facet>& facets, CoverageMap& map) {
  double sum = 0, squares = 0;
  for (std::size_t i = 0; i < facets.size(); ++i) {
    const double area = facets[i].area_mm2;
    map.area_mm2.at(static_cast<std::size_t>(map.triangles[i])) += area;
    if (map.triangles[i] != Coverage::covered) continue;
    const auto d = static_cast<double>(map.distance_mm[i]);
    sum += area * d;
    squares += area * d * d;
  }
  for (std::size_t k = 0; k < kCoverages; ++k)
    if (static_cast<Coverage>(k) > Coverage::occluded) map.visible_mm2 += map.area_mm2.at(k);
  const double covered = map.area_mm2.at(static_cast<std::size_t>(Coverage::covered));
  if (map.visible_mm2 > 0) map.covered_share = covered / map.visible_mm2;
  if (covered > 0) {
    map.agreement_mean_mm = sum / covered;
    map.agreement_rms_mm = std::sqrt(squares / covered);
  }
}

std::array<std::uint8_t, 3> colour(Coverage coverage) {
  switch (coverage) {
    case Coverage::facing_away:
      return {90, 90, 90};
    case Coverage::occluded:
      return {60, 60, 120};
    case Coverage::steep:
      return {120, 170, 220};
    case Coverage::unmatched:
      return {230, 160, 30};
    case Coverage::uncertain:
      return {240, 230, 60};
    case Coverage::repeating:
      return {200, 80, 220};
    case Coverage::disagrees:
      return {220, 30, 30};
    case Coverage::covered:
      return {60, 180, 75};
    case Coverage::outside_view:
      break;
  }
  return {200, 200, 200};
}

}  // namespace

std::string_view name(Coverage coverage) noexcept {
  constexpr std::array<std::string_view, kCoverages> kNames = {
      "outside_view", "facing_away", "occluded",  "steep",  "unmatched",
      "uncertain",    "repeating",   "disagrees", "covered"};
  return kNames.at(static_cast<std::size_t>(coverage));
}

std::string ReconstructedView::comment() const {
  return fmt::format("{} {} {} {} {} {} {} {} {} {} {} {} {} {}", kViewComment, size_px.width,
                     size_px.height, region_px.x, region_px.y, region_px.width, region_px.height,
                     focal_px, cx_px, cy_px, cx_right_px, baseline_mm, nearest_mm, farthest_mm);
}

std::optional<ReconstructedView> view_of(const TriangleMesh& mesh) {
  for (const std::string& line : mesh.comments) {
    std::istringstream words(line);
    words.imbue(std::locale::classic());
    std::string first;
    if (!(words >> first) || first != kViewComment) continue;
    ReconstructedView v;
    words >> v.size_px.width >> v.size_px.height >> v.region_px.x >> v.region_px.y >>
        v.region_px.width >> v.region_px.height >> v.focal_px >> v.cx_px >> v.cy_px >>
        v.cx_right_px >> v.baseline_mm >> v.nearest_mm >> v.farthest_mm;
    constexpr int kSideMaxPx = 20'000;
    const bool is_sound = !words.fail() && v.size_px.width > 0 && v.size_px.width <= kSideMaxPx &&
                          v.size_px.height > 0 && v.size_px.height <= kSideMaxPx &&
                          (v.region_px & cv::Rect({}, v.size_px)) == v.region_px &&
                          v.focal_px > 0 && v.baseline_mm > 0 && v.nearest_mm > 0 &&
                          v.farthest_mm > v.nearest_mm;
    if (!is_sound) throw InputError(fmt::format("comment {}: is not usable", line));
    return v;
  }
  return {};
}

CoverageMap coverage_map(const TriangleMesh& ct, const Eigen::Isometry3d& T_camera_ct,
                         const TriangleMesh& surface, const ReconstructedView& view,
                         const cv::Mat1b& reasons, const CoverageOptions& options) {
  Eigen::Isometry3d T_rectified_camera = Eigen::Isometry3d::Identity();
  if (surface.R_rectified_camera) T_rectified_camera.linear() = *surface.R_rectified_camera;
  const std::vector<Eigen::Vector3d> vertices = in_rectified(ct, T_rectified_camera * T_camera_ct);
  const Judge judge(vertices, ct, surface, view, reasons, options);
  CoverageMap map;
  std::vector<Facet> facets;
  facets.reserve(ct.triangles.size());
  for (const auto& corners : ct.triangles) {
    facets.push_back(facet_of(vertices, corners));
    float distance = std::numeric_limits<float>::quiet_NaN();
    map.triangles.push_back(judge.judge(facets.back(), distance));
    map.distance_mm.push_back(distance);
  }
  summarise(facets, map);
  return map;
}

std::string coverage_ply(const TriangleMesh& ct, const CoverageMap& map) {
  const auto shown = static_cast<std::size_t>(
      std::count_if(map.triangles.begin(), map.triangles.end(),
                    [](Coverage c) { return c != Coverage::outside_view; }));
  std::string bytes = "ply\nformat binary_little_endian 1.0\n";
  for (std::size_t k = 0; k < kCoverages; ++k)
    bytes += fmt::format("comment coverage {} {}\n", k, name(static_cast<Coverage>(k)));
  bytes += fmt::format(
      "element vertex {}\nproperty float x\nproperty float y\nproperty float z\nelement face {}\n"
      "property list uchar int vertex_indices\nproperty uchar red\nproperty uchar green\n"
      "property uchar blue\nproperty uchar coverage\nend_header\n",
      ct.vertices_mm.size(), shown);
  for (const Eigen::Vector3f& p : ct.vertices_mm)
    bytes.append(reinterpret_cast<const char*>(p.data()), 12);
  for (std::size_t i = 0; i < ct.triangles.size(); ++i) {
    if (map.triangles[i] == Coverage::outside_view) continue;
    bytes += static_cast<char>(3);
    bytes.append(reinterpret_cast<const char*>(ct.triangles[i].data()), 12);
    for (const std::uint8_t value : colour(map.triangles[i])) bytes += static_cast<char>(value);
    bytes += static_cast<char>(map.triangles[i]);
  }
  return bytes;
}

}  // namespace holdfast::registration
