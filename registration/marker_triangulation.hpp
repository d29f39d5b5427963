// SPDX-License-Identifier: Apache-2.0
// Markers seen by both cameras to points of the left camera's frame, with what is not known of
// them: the images' noise, marker by marker, and the calibration's, common to all.
#pragma once

#include <string>
#include <vector>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "registration/marker_detection.hpp"
#include "registration/markups.hpp"
#include "registration/stereo_calibration.hpp"

namespace holdfast::registration {

struct MarkerOptions {
  double offset_mm = 0;  ///< the point wanted lies this far below the marker (a bead's 1 mm)
  /// How exactly that is made (1 sigma, mm, the marker's axes: x, y along its sides, z out of it);
  /// counts only where offset_mm is not 0.
  Eigen::Vector3d offset_sigma_mm{0.01, 0.01, 0.02};
  double marker_mm = 0;            ///< side of the black square; 0: not known, measured
  double marker_sigma_mm = 0.01;   ///< how exactly each is made (1 sigma); 0: not used
  int least = 3;                   ///< markers that a registration needs
  double worst_fit_px = 0.5;       ///< rms of one marker's corners in both images
  double worst_side_share = 0.03;  ///< measured side against `marker_mm`
};

struct LocatedMarker {
  int id = 0;
  Eigen::Isometry3d T_camera_marker = Eigen::Isometry3d::Identity();  ///< z out of the holder
  double side_mm = 0;
  double fit_px = 0;  ///< rms of the corners about the square, both images
  Eigen::Vector3d point_mm = Eigen::Vector3d::Zero();  ///< the centre, or offset_mm below it
  Eigen::Matrix3d covariance_mm2 = Eigen::Matrix3d::Zero();
};

struct MarkerSet {
  std::vector<LocatedMarker> markers;    ///< by id
  Eigen::MatrixXd joint_covariance_mm2;  ///< of all points: x y z of the first, then of the next
  std::vector<std::string> skipped;      ///< seen, but not by both; one line each
  /// As these images show it: the zoom seats a little differently at each visit. With what is still
  /// unknown of it. A surface from images of the same visit belongs to this one.
  ZoomCalibration calibration;
};

/// Each marker is the square that fits its corners in both images best, of unknown side or of one
/// known to marker_sigma_mm. `calibration` at the images' zoom; its error, as far as its covariance
/// allows, is estimated from all markers together. Throws RefusedError naming marker, value
/// and limit: an id twice in one image; too few seen by both; the two images disagreeing (left and
/// right swapped, another zoom or calibration); a marker behind the cameras; a side unlike
/// marker_mm.
[[nodiscard]] MarkerSet locate_markers(const std::vector<DetectedMarker>& left,
                                       const std::vector<DetectedMarker>& right,
                                       const ZoomCalibration& calibration,
                                       const MarkerOptions& options);

/// The points for a markups file, labelled aruco-<id>, with each one's covariance and the joint
/// one.
[[nodiscard]] Markups markups_of(const MarkerSet& set);

}  // namespace holdfast::registration
