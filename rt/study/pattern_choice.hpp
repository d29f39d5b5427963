// SPDX-License-Identifier: Apache-2.0
// The dots to project at a zoom, from what `optimize-pattern` found (patterns.toml).
#pragma once

#include <filesystem>
#include <vector>

#include "registration/pattern.hpp"

namespace holdfast::rt {

struct ZoomPattern {
  double zoom = 0;
  registration::PatternParameters pattern;
};

/// Every [[pattern]] of the file, at least one. Throws InputError naming file, key and limit.
[[nodiscard]] std::vector<ZoomPattern> read_best_patterns(const std::filesystem::path& file);

/// That of the nearest zoom: the best dots change little from one zoom to the next. Not empty.
[[nodiscard]] registration::PatternParameters pattern_for(double zoom,
                                                          const std::vector<ZoomPattern>& best);

}  // namespace holdfast::rt
