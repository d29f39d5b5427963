// SPDX-License-Identifier: Apache-2.0
// What one projected pattern was worth, from what was reconstructed under it.
#pragma once

#include "registration/evaluation.hpp"
#include "registration/pattern_table.hpp"
#include "registration/reconstruction.hpp"

namespace holdfast::registration {

/// `reference` in its own frame; T_reference_camera takes the left camera's frame there. Points are
/// drawn from the surface, within `region_mm` of the reference. Pure, same seed same result.
[[nodiscard]] PatternEvaluation judge_pattern(const Reconstruction& result,
                                              const Rectification& geometry,
                                              const ReferenceSurface& reference,
                                              const EvaluationOptions& options, bool is_paper);

}  // namespace holdfast::registration
