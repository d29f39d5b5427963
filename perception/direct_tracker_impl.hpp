// SPDX-License-Identifier: Apache-2.0
// Inside DirectTracker: its state, and the steps of a frame. For direct_tracker*.cpp alone.
#pragma once

#include <chrono>
#include <optional>

#include "perception/direct_keyframe.hpp"
#include "perception/direct_tracker.hpp"
#include "perception/image_shift.hpp"
#include "perception/pyramid.hpp"
#include "perception/tied_keyframes.hpp"
#include "perception/tracker_parameters.hpp"

namespace holdfast::perception {

struct DirectTracker::Impl {
  static constexpr int kCoarsest = kPyramidLevels - 1;

  CameraModel camera;
  TrackerParameters parameters;

  std::optional<DirectKeyframe> first;
  TiedKeyframes ties;
  DirectKeyframe* key =
      nullptr;  // in use: the first, or one tied to it; all poses here are since it

  int frames_since_learning = 0;  // what is fixed to the camera

  Pyramid pyramid;
  ImageShift shift;
  std::optional<Eigen::Isometry3d> T_newest, T_before;  // of the last frames, if not lost
  std::optional<std::chrono::nanoseconds> t_newest;
  bool has_inliers = false;  // what the aligner of the keyframe in use did last is the estimate

  Impl(const CameraModel& c, const TrackerParameters& p) : camera(c), parameters(p), ties(c, p) {
    camera.distortion = c.distortion.clone();
  }

  // direct_tracker.cpp: follows and judges.
  [[nodiscard]] TrackingReason take_keyframe(const GivenKeyframe& given,
                                             const cv::Mat& moving_half);
  void estimate(const cv::Mat& image, MotionEstimate& out);
  bool follow(MotionEstimate& out);
  [[nodiscard]] Eigen::Isometry3d predicted();
  bool accept(const Alignment& alignment, MotionEstimate& out);
  [[nodiscard]] TrackingReason unsound(const Alignment& alignment) const;
  void fill(const Alignment& alignment, MotionEstimate& out);
  void compare_chain(MotionEstimate& out);
  void compare_features(const cv::Mat& image, MotionEstimate& out);
  void object(MotionEstimate& out) const;
  [[nodiscard]] bool is_contradicted(const MotionEstimate& out) const;

  // direct_tracker_search.cpp: finds the site again.
  [[nodiscard]] std::optional<Eigen::Isometry3d> recalled();
  bool relocalise(const cv::Mat& image, MotionEstimate& out);
  bool relocalise_by_any(const cv::Mat& image, MotionEstimate& out);
  bool learn_fixed(const cv::Mat& image, MotionEstimate& out);
  void forget_motion();
  void lose(MotionEstimate& out);

  // direct_tracker_ties.cpp: changes the keyframe in use.
  void use(TiedKeyframe* next);
  void tend_ties(const cv::Mat& image, MotionEstimate& out);
  [[nodiscard]] Eigen::Vector3d p_pivot_of_first() const;
};

}  // namespace holdfast::perception
