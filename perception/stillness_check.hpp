// SPDX-License-Identifier: Apache-2.0
// What is fixed to the microscope (projected dots, dust, an aiming beam) is seen at the same place
// in every frame, and votes for "no motion" with all the strength of its texture. So a motion of
// none is asked for more than the agreement of the patches that were chosen: the rest of the image
// must look as it did at the keyframe, too. Where it does not, what stayed is fixed to the
// microscope, and what changed is the site.
//
// Blind to brightness and contrast, block by block. Things that come and go in a part of the image
// (an instrument, blood) are not a contradiction; a change all over it is.
#pragma once

#include <vector>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "perception/camera_model.hpp"
#include "perception/pyramid.hpp"
#include "perception/site.hpp"
#include "perception/tracker_parameters.hpp"

namespace holdfast::perception {

/// Belongs to one keyframe. One thread at a time.
class StillnessCheck {
 public:
  /// Copies what it needs of the keyframe.
  StillnessCheck(const CameraModel& camera, const Site& site, const HealthParameters& health,
                 const Pyramid& keyframe);

  /// The pose moves nothing in the image by more than half a pixel, yet `image` (as large as the
  /// keyframe) has changed all over. `noise_grey`: of one pixel. Allocation-free.
  [[nodiscard]] bool contradicts(const Eigen::Isometry3d& T_camera_site, const Pyramid& image,
                                 double noise_grey) const;
  /// CV_8UC1 of half size: 0 where texture looks as at the keyframe, and around it. To be asked
  /// when the rest has moved by two pixels at least.
  [[nodiscard]] cv::Mat moving_half(const Pyramid& image) const;

 private:
  [[nodiscard]] bool is_still(const Eigen::Isometry3d& T_camera_site) const;
  [[nodiscard]] bool has_changed(const cv::Mat& quarter, double noise_grey) const;
  std::vector<Eigen::Vector3d> p_site_mm_;  // seen in the corners and the middle of the image
  double f_px_;
  double share_max_, spread_max_;
  cv::Mat half_, quarter_;
};

}  // namespace holdfast::perception
