// SPDX-License-Identifier: Apache-2.0
// The stages from a rig's files to a registration, each by the same library calls as the command of
// its name: what `study` and `demo --setup` string together.
#pragma once

#include <filesystem>
#include <functional>
#include <string>

#include "registration/calibration_run.hpp"
#include "registration/marker_triangulation.hpp"
#include "registration/markups.hpp"
#include "registration/mesh_file.hpp"
#include "registration/reconstruction.hpp"

namespace holdfast::rt {

/// What is known beforehand of the phantom and the board: paper A's, as the manuals of a real set
/// would state it.
struct SetupParameters {
  registration::BoardPattern board{9, 5, 3};  ///< inner corners, side in mm
  double bead_diameter_mm = 1.5;
  double bead_below_marker_mm = 1.0;
  double marker_mm = 8.0;  ///< side of the black square
  double iso_hu = -400;    ///< between air and the model's plastic (or skin)
  int threads = 2;
};

/// `calibrate --images`. Throws as it does; `tell` hears what is being done.
[[nodiscard]] registration::CalibrationOutcome calibrate_images(
    const std::filesystem::path& images, const SetupParameters& parameters,
    const std::function<void(const std::string&)>& tell);

/// `surface` (largest piece) and `fiducials`.
struct CtSide {
  registration::TriangleMesh surface;  ///< carries the series and frame of reference
  registration::Markups beads;
};
[[nodiscard]] CtSide read_ct_side(const std::filesystem::path& dicom,
                                  const SetupParameters& parameters);

/// `markers --offset-mm --marker-mm --seated`: the beads below the markers, camera frame, and the
/// calibration as these frames show it. Pattern-off frames.
[[nodiscard]] registration::MarkerSet locate_beads(const registration::StereoShot& frames,
                                                   const registration::ZoomCalibration& calibration,
                                                   const SetupParameters& parameters);

}  // namespace holdfast::rt
