// SPDX-License-Identifier: Apache-2.0
// How far a reconstructed surface is from a reference surface: paper A's closest-point figure, and
// beside it the distance to the reference's triangles, which the reference's vertex spacing does
// not flatter or spoil.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "registration/mesh_file.hpp"

namespace holdfast::registration {

/// Of unsigned distances, mm.
struct DistanceFigures {
  std::size_t count = 0;
  double mean_mm = 0;  ///< paper A calls this its RMSE
  double sd_mm = 0;
  double rmse_mm = 0;
  double median_mm = 0, p90_mm = 0, p95_mm = 0, p99_mm = 0, max_mm = 0;
  double share_over_1_mm = 0;  ///< 0..1
};

/// NaN for an empty set.
[[nodiscard]] DistanceFigures distance_figures(std::vector<double> distances_mm);

struct EvaluationOptions {
  /// Takes the surface's points into the reference's frame.
  Eigen::Isometry3d T_reference_surface = Eigen::Isometry3d::Identity();
  /// In the reference's frame; points outside are left out.
  std::optional<Eigen::AlignedBox3d> region_mm;
  std::size_t points = 5000;  ///< drawn without replacement; all, if there are fewer
  std::uint64_t seed = 1;
};

struct Evaluation {
  std::size_t points_in_region = 0;
  DistanceFigures to_vertex;    ///< the nearest vertex of the reference (paper A, closest points)
  DistanceFigures to_triangle;  ///< the nearest point of its triangles; all NaN for a cloud
  /// The drawn points (frame reference) and their distances to the triangles, else to vertices.
  std::vector<Eigen::Vector3d> p_reference_mm;
  std::vector<double> distance_mm;
};

/// A reference that is evaluated against more than once: its trees are built here, not each time.
class ReferenceSurface {
 public:
  /// Copies what it needs. O(n log n).
  explicit ReferenceSurface(const TriangleMesh& reference);
  ~ReferenceSurface();
  ReferenceSurface(const ReferenceSurface&) = delete;
  ReferenceSurface& operator=(const ReferenceSurface&) = delete;

 private:
  friend Evaluation evaluate_surface(const TriangleMesh& surface, const ReferenceSurface& reference,
                                     const EvaluationOptions& options);
  struct Trees;
  std::unique_ptr<const Trees> trees_;
};

/// Draws the points and measures. Pure, same seed same result. An empty region gives counts of 0.
[[nodiscard]] Evaluation evaluate_surface(const TriangleMesh& surface,
                                          const ReferenceSurface& reference,
                                          const EvaluationOptions& options);
/// The same, once.
[[nodiscard]] Evaluation evaluate_surface(const TriangleMesh& surface,
                                          const TriangleMesh& reference,
                                          const EvaluationOptions& options);

/// Paper A, Fig. 7: the distances seen along the reference's z axis (x to the right, y down), as a
/// colour image with its scale, 0 to `scale_max_mm`. Grey where nothing was drawn.
[[nodiscard]] cv::Mat heat_map(const Evaluation& evaluation, double scale_max_mm);

}  // namespace holdfast::registration
