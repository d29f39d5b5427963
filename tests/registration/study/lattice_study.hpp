// SPDX-License-Identifier: Apache-2.0
// How well pattern_lattice.hpp tells a lattice from patterns that do not repeat, on rendered images
// of ears at the five zooms, dots of all sizes and distances, with and without the pattern's
// filter.
#pragma once

#include <filesystem>

namespace holdfast::test {

/// Renders what `cache` does not hold yet; prints a line an image, then for each kind of pattern
/// the range of what repeats and how many would be refused.
void study_lattices(const std::filesystem::path& cache);

}  // namespace holdfast::test
