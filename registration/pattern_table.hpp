// SPDX-License-Identifier: Apache-2.0
// What one projected pattern was worth, as in the two files of `optimize-pattern`: the CSV of every
// evaluation, from which a search resumes, and patterns.toml with the best dots of each zoom.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "registration/dots.hpp"
#include "registration/pattern.hpp"

namespace holdfast::registration {

/// The value of a pattern whose reconstruction is refused, and of a point that is not known.
constexpr double kUnknownMm = 1.0;
/// Paper A's mean has no bound; of what it cannot reconstruct it says nothing.
constexpr double kUnknownInPaperMm = 3.0;

struct PatternEvaluation {
  double zoom = 0;
  Dots dots;
  std::string status = "done";  ///< as name(ReconstructionStatus)
  /// What is minimised. Ours: coverage · mean(min(distance to triangle, 1 mm)) + (1 - coverage) ·
  /// 1 mm, so that an error, an outlier and a hole all cost. Paper A's: the mean distance to the
  /// closest vertex.
  double objective_mm = kUnknownMm;
  double triangle_mean_mm = 0, closest_mean_mm = 0;  ///< 0 where refused, as the rest
  double wrong_share = 0;                            ///< more than 1 mm from the triangles
  double coverage = 0;                               ///< of the region that was reconstructed
};

/// How the search was asked for; a CSV of another search is not resumed.
struct PatternTableHead {
  PatternKind kind = PatternKind::aperiodic;
  bool is_paper = false;
  std::uint64_t seed = 1;
};

[[nodiscard]] std::string pattern_table_text(const PatternTableHead& head,
                                             const std::vector<PatternEvaluation>& evaluations);
/// The inverse. Throws InputError naming `path`, line and fault, also when the head differs.
[[nodiscard]] std::vector<PatternEvaluation> parse_pattern_table(const std::string& path,
                                                                 std::string_view text,
                                                                 const PatternTableHead& head);

/// The best of one zoom, and after how many evaluations.
struct BestPattern {
  double zoom = 0;
  Dots dots;
  double objective_mm = 0;
  int evaluations = 0;
};
[[nodiscard]] std::string patterns_toml(const PatternTableHead& head,
                                        const std::vector<BestPattern>& best);

[[nodiscard]] std::string_view name(PatternKind kind) noexcept;

}  // namespace holdfast::registration
