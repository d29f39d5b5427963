// SPDX-License-Identifier: Apache-2.0
// Paper B's experiment on a rig, and what it leaves out: scenes x motions, each followed by our
// tracker with the depth that a reconstruction really delivers, by our features alone, and by the
// paper's own method, on the same frames.
#pragma once

#include <chrono>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "perception/motion_estimate.hpp"
#include "rt/study/rig.hpp"
#include "rt/study/stage_statistics.hpp"
#include "rt/study/stages.hpp"
#include "rt/study/study.hpp"

namespace holdfast::rt {

struct TrackingScene {
  std::string name;  ///< of the object, as the rig knows it
  RigCommand rig;    ///< that shows it
};

struct TrackingSettings {
  std::vector<TrackingScene> scenes;
  std::vector<std::string> motions;
  double rate_hz = 3;  ///< paper B's
  double zoom = 1.3;
  int calibration_pairs = 19;
  SetupParameters setup;
  /// Where the beam lands of a robot that follows the tracked pose; none: not asked. Each begins
  /// with a second at rest, in which permission is given.
  std::vector<std::string> beam_motions;
  double beam_rate_hz = 60;
};

/// One scene, motion and method.
struct TrackingRow {
  std::string scene, motion, method;  ///< method: direct, orb, paper
  std::string refusal;                ///< why nothing below counts
  TrackingJudgement judged;
  std::vector<StageTime> stages;
  std::vector<double> x_um, y_um, error_x_um, error_y_um;  ///< a frame with a pose: the truth, and
  std::vector<double> step_x_um, step_y_um;  ///< how wrong; errors of two frames in turn
};

/// One scene and motion, steered by the direct tracker's poses.
struct BeamRow {
  std::string scene, motion;
  std::string refusal;              ///< why nothing below counts
  std::chrono::nanoseconds lead{};  ///< that poses were predicted ahead: none, or the robot's lag
  BeamJudgement judged;
  int stops = 0;
  std::string stop_causes;
};

struct TrackingResult {
  std::vector<TrackingRow> rows;
  std::vector<BeamRow> beam;
  double calibration_rms_px = 0;
  std::map<std::string, double> depth_coverage;  ///< of the frame, a scene
};

/// Works in `folder`: stereo.yaml, SCENE/depth.tiff, SCENE/MOTION/METHOD.csv (poses) and
/// METHOD_errors.csv. Throws as the stages and the rig; what a tracker refuses is a row, no error.
[[nodiscard]] TrackingResult run_tracking_study(const TrackingSettings& settings,
                                                const std::filesystem::path& folder,
                                                const StudyProgress& progress);

}  // namespace holdfast::rt
