// SPDX-License-Identifier: Apache-2.0
// How far a depth map, as the pipeline measured it, is from what the microscope truly saw: point by
// point along the pixel's own line of sight, so that no closest point can flatter it.
#pragma once

#include <cstddef>

#include <opencv2/core.hpp>

#include "registration/stereo_calibration.hpp"
#include "tests/sim/or/room_files.hpp"

namespace holdfast::sim {

struct DepthErrorOptions {
  int step_px = 8;            ///< every so many pixels of the rectified left grid are looked at
  int edge_reach_px = 8;      ///< a depth edge this near makes a pixel one at an edge
  double edge_jump_mm = 0.5;  ///< what counts as one
};

/// Of the pixels whose surface lies in the phantom's region of interest and is seen by both
/// cameras. Errors in 3-D, mm; what the calibration moves as a whole is no error
/// (frame_of()). NaN where nothing is known.
struct DepthError {
  std::size_t seen = 0;   ///< such pixels
  std::size_t known = 0;  ///< of them, with a depth in the map
  double coverage = 0;    ///< known of seen
  double median_mm = 0, mean_mm = 0, rms_mm = 0, p95_mm = 0, p99_mm = 0;
  double share_over_1_mm = 0;            ///< of the known
  double share_over_1_mm_off_edges = 0;  ///< of the known that are not at a depth edge
};

/// `depth_mm`: CV_32F on the rectified left grid of `calibration`, what the pipeline used; the room
/// at `pose` (0-based) of `config`. Throws InputError for a map of another size or such a pose.
[[nodiscard]] DepthError depth_error(const cv::Mat_<float>& depth_mm,
                                     const registration::ZoomCalibration& calibration,
                                     const RoomConfig& config, const RoomScene& scene, int pose,
                                     const DepthErrorOptions& options = {});

}  // namespace holdfast::sim
