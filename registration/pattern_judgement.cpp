// SPDX-License-Identifier: Apache-2.0
#include "registration/pattern_judgement.hpp"

#include <algorithm>
#include <numeric>

namespace holdfast::registration {

PatternEvaluation judge_pattern(const Reconstruction& result, const Rectification& geometry,
                                const ReferenceSurface& reference, const EvaluationOptions& options,
                                bool is_paper) {
  constexpr int kMeshStepPx = 4;  // of the points that are drawn from
  PatternEvaluation judged;
  judged.status = name(result.status);
  judged.objective_mm = is_paper ? kUnknownInPaperMm : kUnknownMm;
  if (result.status != ReconstructionStatus::done) return judged;
  const TriangleMesh surface = mesh_of(result, geometry, kMeshStepPx);
  EvaluationOptions in_rectified = options;
  in_rectified.T_reference_surface =
      options.T_reference_surface *
      Eigen::Isometry3d{Eigen::Matrix3d{surface.R_rectified_camera->transpose()}};
  const Evaluation evaluation = evaluate_surface(surface, reference, in_rectified);
  if (evaluation.points_in_region == 0) {
    judged.status = "nothing in the region";
    return judged;
  }
  judged.triangle_mean_mm = evaluation.to_triangle.mean_mm;
  judged.closest_mean_mm = evaluation.to_vertex.mean_mm;
  judged.wrong_share = evaluation.to_triangle.share_over_1_mm;
  judged.coverage = result.density;
  const double bounded = std::accumulate(
      evaluation.distance_mm.begin(), evaluation.distance_mm.end(), 0.0,
      [](double sum, double distance) { return sum + std::min(distance, kUnknownMm); });
  const double mean = bounded / static_cast<double>(evaluation.distance_mm.size());
  judged.objective_mm = is_paper ? std::max(judged.closest_mean_mm, 1e-6)
                                 : judged.coverage * mean + (1 - judged.coverage) * kUnknownMm;
  return judged;
}

}  // namespace holdfast::registration
