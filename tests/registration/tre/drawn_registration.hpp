// SPDX-License-Identifier: Apache-2.0
// What a set-up on the virtual rig would have measured, drawn instead of rendered, so that a
// thousand set-ups take minutes: board corners and marker corners through the true optics (a lens
// richer than any model that is fitted to it, seated anew at each visit), holders made as exactly
// as the rig makes them, and detection noise of an assumed size, which the product is told exactly
// (markers and beads). From the pixels on everything is the product's: calibration, markers, fit,
// covariances.
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Geometry>

#include "registration/ct_registration.hpp"
#include "registration/marker_triangulation.hpp"
#include "tests/sim/or/optics.hpp"
#include "tests/sim/or/phantom.hpp"

namespace holdfast::registration::test {

/// 1 sigma; assumed. Rendered boards leave 0.007 to 0.015 px rms after calibration.
struct DetectionNoise {
  double board_corner_px = 0.025;  ///< of one coordinate
  double marker_side_px = 0.01;    ///< of a marker's side in one image, across it
  double bead_mm = 0.01;           ///< of a bead's centre in the CT, each coordinate
};

struct DrawnRig {
  std::uint32_t seed = 1;  ///< microscope, board and its poses, visits, pose, noise
  double zoom = 1.3;
  int pairs = 19;  ///< of the calibration
  DetectionNoise noise;
};

struct DrawnMeasurement {
  ZoomCalibration calibration;
  std::vector<DetectedMarker> left, right;  ///< the markers' corners
  Markups beads;                            ///< CT
  MarkerSet markers;                        ///< camera; with the calibration as they show it seated
  sim::StereoOptics optics;                 ///< as seated when the markers were seen
  Eigen::Isometry3d T_ct_head;
  /// The truth: in the frame of the calibration, the zoom seated as on average.
  Eigen::Isometry3d T_camera_ct;
};

/// As the set-up asks for the beads below the markers.
[[nodiscard]] MarkerOptions bead_options();

/// Calibrates and looks once. `phantom`: its markers and where one looks. Same seed, same result.
/// Throws RefusedError as calibrate_stereo() and locate_markers() do.
[[nodiscard]] DrawnMeasurement draw_measurement(const DrawnRig& rig, const sim::Phantom& phantom);

}  // namespace holdfast::registration::test
