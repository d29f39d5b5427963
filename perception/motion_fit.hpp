// SPDX-License-Identifier: Apache-2.0
// From matched features of two views to the motion: consensus, a look for a rival motion, sub-pixel
// alignment of the inliers, robust refinement, covariance. Used alike against the keyframe and
// against the previous frame.
#pragma once

#include <optional>
#include <vector>

#include "perception/camera_model.hpp"
#include "perception/features.hpp"
#include "perception/matcher.hpp"
#include "perception/pose_fit.hpp"
#include "perception/reflection_mask.hpp"
#include "perception/site.hpp"
#include "perception/tracker_parameters.hpp"

namespace holdfast::perception {

/// One image with what was found in it.
struct View {
  GreyAndMask images;
  Features features;
};

struct MotionFit {
  PoseFit pose;            ///< after sub-pixel alignment
  int coarse_inliers = 0;  ///< of the matches, before alignment
  int rival_inliers = 0;   ///< matches that agree on another motion
  double spread = 0;       ///< fraction of the 8x8 image cells of the target with an inlier
  Matrix6d covariance = Matrix6d::Zero();  ///< as MotionEstimate::covariance
};

struct MotionProblem {
  const CameraModel& camera;
  const TrackerParameters& parameters;
  const Site& site;
  const View& source;
  const std::vector<Eigen::Vector3d>& p_site_mm;  ///< of each source feature; NaN: not known
  const Eigen::Isometry3d& T_source_site;         ///< pose of the source view
  const View& target;
  const std::vector<Match>& matches;  ///< first: source, second: target
};

/// The pose of the target view, or why there is none.
struct MotionResult {
  std::optional<MotionFit> fit;
  TrackingReason reason = TrackingReason::none;
};
[[nodiscard]] MotionResult fit_motion(const MotionProblem& problem);

}  // namespace holdfast::perception
