// SPDX-License-Identifier: Apache-2.0
// Period slips over random poses, reliefs and dots of the quick analytic rig (stereo_rig.hpp): the
// virtual microscope would need hours for as many.
#pragma once

namespace holdfast::test {

/// Prints how many reconstructions of scenes `first` … `first + poses - 1` slip (more than 0.5 % of
/// the points further than 2 mm away), with and without the check of pattern_repetition.hpp, and
/// how many are refused; a line every 50 scenes.
void study_slips(int first, int poses, bool is_lattice);

}  // namespace holdfast::test
