// SPDX-License-Identifier: Apache-2.0
// The set-up before an operation, on a rig, without a number typed: calibration, CT, pattern,
// reconstruction, registration, and the keyframe with its depth that the tracker lives on.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "registration/pattern.hpp"
#include "rt/study/rig.hpp"
#include "rt/study/stages.hpp"

namespace holdfast::rt {

struct SetupSettings {
  double zoom = 1.3;
  RigCommand rig;
  int calibration_pairs = 19;
  registration::PatternParameters pattern;
  double deep_target_mm = 15;  ///< the second target lies this far below the surface
  SetupParameters parameters;
};

struct SetupStage {
  std::string name;
  std::string measured;  ///< one line
  double seconds = 0;
};

struct SetupOutcome {
  std::vector<SetupStage> stages;  ///< as far as it came
  std::string refusal;             ///< of the stage after the last; empty: registered
  double fre_mm = 0;
  std::vector<std::pair<std::string, double>> predicted_tre_mm;  ///< target, rms
};

/// Writes to `folder`: boards/, dicom/, pair/, stereo.yaml, ct.ply, fiducials.mrk.json,
/// markers.mrk.json, pattern.png, mire.ply, seated.yaml, camera.yaml and keyframe.png with
/// depth.tiff (on its undistorted grid), T.tfm, registration.json. A registration.json that stood
/// there before is removed first: whatever is refused leaves none. Throws as the rig, and
/// InputError.
[[nodiscard]] SetupOutcome run_setup(const SetupSettings& settings,
                                     const std::filesystem::path& folder,
                                     const std::function<void(const std::string&)>& tell);

/// A depth map of the rectified left camera, seen by the left camera itself without distortion
/// (they share their centre): `size_px` and `camera_matrix` of that. NaN where unknown; nearest
/// pixel, so that no depth is mixed across an edge. mm.
[[nodiscard]] cv::Mat1f depth_for_camera(const cv::Mat1f& rectified_mm,
                                         const registration::Rectification& geometry,
                                         const cv::Matx33d& camera_matrix);

}  // namespace holdfast::rt
