// SPDX-License-Identifier: Apache-2.0
// One stereo pair of the study: registered by its markers, reconstructed by both matchers, measured
// against the CT.
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "registration/reconstruction.hpp"
#include "rt/study/fiducial_region.hpp"
#include "rt/study/stages.hpp"
#include "rt/study/study_row.hpp"

namespace holdfast::rt {

/// What all pairs of one zoom share.
struct StudyBench {
  const CtSide& ct;
  const FiducialRegion& region;
  const registration::ZoomCalibration& calibration;
  const SetupParameters& setup;
  int points;
  std::uint64_t seed;
};

struct StudyPair {
  registration::StereoShot shot, markers;       ///< `markers`: without the pattern
  std::vector<registration::StereoShot> burst;  ///< `shot` and more of the same pose; empty: none
};

/// Judges a depth map, made with `seated`, against the truth; fills `row`'s figures.
using DepthJudge = std::function<void(const cv::Mat& depth_mm,
                                      const registration::ZoomCalibration& seated, StudyRow& row)>;

/// One row a method: sgm, opencv and, where there is one, burst. All reconstruct with the
/// calibration as the markers show the zoom seated. `heat_map`, if given, is called with the method
/// and the finished picture.
[[nodiscard]] std::vector<StudyRow> measure_pair(
    const StudyBench& bench, const StudyPair& pair, const StudyRow& identity,
    const DepthJudge& judge,
    const std::function<void(const std::string& method, const cv::Mat&)>& heat_map);

}  // namespace holdfast::rt
