// SPDX-License-Identifier: Apache-2.0
// Paper A's study on a rig: zooms x illuminations x repeats, each pair reconstructed by our matcher
// and by OpenCV's SGBM in the same run. Settings are written down before the first image is made;
// every pair's rows are a file of their own, so that an interrupted study goes on where it was.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "registration/pattern.hpp"
#include "rt/study/rig.hpp"
#include "rt/study/stages.hpp"
#include "rt/study/study_row.hpp"

namespace holdfast::rt {

struct StudySettings {
  std::vector<double> zooms{1.1, 1.2, 1.3, 1.4, 1.5};
  int repeats = 10;
  RigCommand rig;          ///< another rig is another study
  std::uint64_t seed = 1;  ///< of the drawing
  int calibration_pairs = 19;
  int points = 5000;  ///< drawn of each reconstruction, as in the paper
  /// Of a burst under the adaptive light, each with a pattern of its own: a third row, of method
  /// "burst"; 1: none.
  int shots = 1;

  std::vector<registration::PatternParameters> patterns;  ///< adaptive, one a zoom
  SetupParameters setup;
};

/// Says how far it is: `done` of `all` pairs, and what it does now. Throws to end the work.
using StudyProgress = std::function<void(int done, int all, const std::string& what)>;

struct StudyPicture {
  std::string title;
  std::filesystem::path file;  ///< PNG
};

struct StudyResult {
  std::vector<StudyRow> rows;  ///< by zoom, illumination, repeat, method
  std::vector<StudyPicture> heat_maps;
  double calibration_rms_px = 0;
  int resumed = 0;  ///< pairs that were there already
};

/// Works in `folder`: study.json, stereo.yaml, ct.ply, fiducials.mrk.json, patterns/, cells/,
/// heat/. Throws InputError when `folder` holds a study of other settings, else as the stages and
/// the rig; a reconstruction or registration that is refused is a row, no error.
[[nodiscard]] StudyResult run_study(const StudySettings& settings,
                                    const std::filesystem::path& folder,
                                    const StudyProgress& progress);

}  // namespace holdfast::rt
