// SPDX-License-Identifier: Apache-2.0
// The projector's images (paper A, "Adaptive pattern generator"): dots of a size and a distance on
// a lattice, the same lattice made aperiodic, and random dots.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

namespace holdfast::registration {

inline constexpr int kPatternWidthPx = 800, kPatternHeightPx = 600;  // the projector's mirrors

enum class PatternKind {
  /// Each cell of the lattice holds a dot or none, by even chance, moved within its own gap: no row
  /// repeats another, so a matcher cannot lock one period off. The default.
  aperiodic,
  lattice,  ///< paper A's: every cell, in place. A matcher may slip by a period
  random    ///< as many dots as the aperiodic pattern has, anywhere, also on each other
};

/// What can be projected and told apart (paper A); projector pixels.
constexpr double kDotMinPx = 2, kDotMaxPx = 16, kDistanceMinPx = 1, kDistanceMaxPx = 10;

struct PatternParameters {
  PatternKind kind = PatternKind::aperiodic;
  double dot_px = 4;       ///< diameter s, 2 to 16
  double distance_px = 4;  ///< gap d between neighbours on the lattice, 1 to 10: the pitch is s + d
  std::uint64_t seed = 1;
};

/// What is wrong with the parameters, in one line with value, limit and unit.
[[nodiscard]] std::optional<std::string> invalid_pattern(const PatternParameters& parameters);

/// 600x800, CV_8UC1, 0 dark, 255 lit; the discs' rims are grey by the share of the pixel that they
/// cover. Pure: same parameters, same pixels. Precondition: not invalid_pattern().
[[nodiscard]] cv::Mat make_pattern(const PatternParameters& parameters);

/// One cell of the lattice: its middle, where its dot is, and whether it has one.
struct PatternCell {
  cv::Point2d centre_px, dot_px;
  bool is_lit = false;
};
/// What make_pattern() draws. Precondition: not invalid_pattern().
[[nodiscard]] std::vector<PatternCell> pattern_cells(const PatternParameters& parameters);
/// A disc as make_pattern() draws it, of this grey in its middle; what is brighter there stays.
void draw_dot(cv::Mat& image, cv::Point2d centre_px, double diameter_px, int grey = 255);

}  // namespace holdfast::registration
