// SPDX-License-Identifier: Apache-2.0
// What a second shot is worth whose pattern is refined where the first one's surface is poor,
// against a second shot under just another pattern.
#pragma once

#include <filesystem>
#include <functional>
#include <string>

#include "registration/reconstruction.hpp"
#include "tests/registration/study/rendered_pairs.hpp"

namespace holdfast::test {

/// Prints the figures of one surface of `pair`.
using PrintFigures = std::function<void(const RenderedPair& pair, const std::string& what,
                                        const registration::Reconstruction& result)>;

/// One shot of `scene`; then with a second one under a plain pattern, the first's complement in
/// poor places only, the complement, and the refined pattern.
void study_refined(const RenderedScene& scene, const std::filesystem::path& cache,
                   const PrintFigures& print);

}  // namespace holdfast::test
