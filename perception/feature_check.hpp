// SPDX-License-Identifier: Apache-2.0
// The motion since the keyframe as ORB features see it (paper B, sections 2.2.2-2.2.5): independent
// of direct alignment and of all frames before, so that it can check the one and do without the
// others.
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "perception/motion_fit.hpp"
#include "perception/tracker.hpp"
#include "perception/tracker_parameters.hpp"

namespace holdfast::perception {

struct FeatureMotion {
  std::optional<MotionFit> fit;  ///< consistent: share of the matches, rival, spread as
                                 ///< HealthParameters wants them of a pose that is not lost
  TrackingReason reason = TrackingReason::none;  ///< why there is none
  int features = 0, matches = 0;
};

class FeatureCheck {
 public:
  /// As Tracker's.
  FeatureCheck(const CameraModel& camera, const TrackerParameters& parameters);

  /// `moving_half` (CV_8UC1 of half size, or empty): 0 where the image shows what is fixed to the
  /// camera: no feature of any frame is taken there.
  [[nodiscard]] TrackingReason set_keyframe(const cv::Mat& image, const Site& site,
                                            const cv::Mat& mask, const cv::Mat& moving_half = {});

  /// Exhaustive: every feature against every other, so that a second motion anywhere in the image
  /// is seen. Should too few agree on any, and `T_predicted` be given, guided: only near where it
  /// puts them. The image must have the camera's size and be CV_8UC1 or CV_8UC3. One thread at a
  /// time.
  [[nodiscard]] FeatureMotion find(const cv::Mat& image,
                                   const std::optional<Eigen::Isometry3d>& T_predicted);

 private:
  [[nodiscard]] FeatureMotion fit(const std::vector<Match>& matches);
  [[nodiscard]] TrackingReason judge(const MotionFit& fit, int matches) const;
  CameraModel camera_;
  TrackerParameters parameters_;
  FeatureDetector detector_;
  Site site_;
  View keyframe_, current_;
  std::vector<Eigen::Vector3d> p_site_mm_;
  cv::Mat moving_half_;
};

}  // namespace holdfast::perception
