// SPDX-License-Identifier: Apache-2.0
// What the tracker says about one frame: a status, the motion since the keyframe, and the evidence
// for it. On `lost` no number in it may be used; there is never a fallback pose.
#pragma once

#include <chrono>
#include <cstdint>
#include <string_view>

#include <Eigen/Geometry>

namespace holdfast::perception {

using Matrix6d = Eigen::Matrix<double, 6, 6>;

enum class TrackingStatus : std::uint8_t { tracking, relocalised, degraded, lost };
[[nodiscard]] std::string_view name(TrackingStatus status) noexcept;

/// Why an estimate is degraded or lost.
enum class TrackingReason : std::uint8_t {
  none,
  no_keyframe,
  wrong_image_size,
  wrong_image_type,
  too_few_features,
  too_few_matches,
  too_few_inliers,
  inliers_bunched,      ///< inliers cover too little of the image
  inconsistent_motion,  ///< no rigid motion explains the matches well enough
  implausible_motion,   ///< scale or rotation outside what the optics allow
  drift_disagreement,   ///< keyframe-anchored and frame-to-frame motion disagree
  invalid_geometry,     ///< set_keyframe only: the site's depth is unusable
  time_not_increasing,  ///< not exposed after the frame before: duplicated or swapped stamps
  check_disagreement,   ///< features, checked independently, see another motion
  unchecked,            ///< features have found no motion for too long
  fixed_pattern,        ///< the image has changed all over, yet what is found has not moved
  tie_doubtful,         ///< the tie between the keyframe in use and the first cannot be relied on
  out_of_focus          ///< the image is blurred against the keyframe, or the other way round
};
[[nodiscard]] std::string_view name(TrackingReason reason) noexcept;

struct StageTimes {  ///< wall time of each stage of this frame
  std::chrono::nanoseconds mask{}, detect{}, match{}, model{};            ///< Tracker
  std::chrono::nanoseconds pyramid{}, align{}, chain{}, check{}, ties{};  ///< DirectTracker
  std::chrono::nanoseconds total{};
};

struct MotionEstimate {
  TrackingStatus status = TrackingStatus::lost;
  TrackingReason reason = TrackingReason::no_keyframe;
  std::chrono::nanoseconds t_exposure{};  ///< mid-exposure, as passed to track()

  Eigen::Isometry3d T_camera_site =
      Eigen::Isometry3d::Identity();  ///< keyframe's camera frame to now
  /// tx,ty,tz (mm), rx,ry,rz (rad), camera axes, about the site point on the optical axis at the
  /// keyframe (the pivot): p_camera = Exp(r)·(T·p - T·pivot) + T·pivot + t.
  Matrix6d covariance = Matrix6d::Zero();
  Eigen::Vector3d p_pivot_site_mm = Eigen::Vector3d::Zero();

  double dx_um = 0, dy_um = 0;  ///< image-plane motion of the site, right and down positive
  double rotation_rad = 0;      ///< in-plane, relative to the keyframe
  double scale = 1;             ///< relative to the keyframe

  int features = 0;
  int matches = 0;
  int inliers = 0;
  double inlier_spread = 0;         ///< fraction of image cells (8x8) that hold an inlier, 0..1
  double reprojection_rms_px = 0;   ///< of the inliers
  bool has_frame_to_frame = false;  ///< the next two are measured
  double frame_to_frame_dx_um = 0,
         frame_to_frame_dy_um = 0;  ///< of the pivot since the previous frame, measured on its own
  bool has_drift = false;           ///< the frame-to-frame chain is unbroken since its last anchor
  /// |frame-to-frame chain - keyframe-anchored| at the pivot, in the image plane. The chain is
  /// anchored anew after a break, every HealthParameters::chain_length_max frames while both agree,
  /// and after a disagreement that a search without prediction has decided. It goes on from one
  /// keyframe to the next: a change of keyframe does not anchor it.
  double drift_um = 0;

  // DirectTracker only.
  double zncc = 0;            ///< mean likeness of the inliers to the keyframe, -1..1
  double brightness = 1;      ///< relative to the keyframe
  double contrast = 1;        ///< of the texture; against `brightness`, what blur or smoke took
  double noise_grey = 0;      ///< of one pixel, what the motion does not explain
  bool has_check = false;     ///< the next two are of a check not reported before
  double check_um = 0;        ///< |features - direct| at the pivot, in the image plane
  double check_sigma = 0;     ///< the same in standard deviations of both
  int keyframe = 0;           ///< in use: 0 the first, 1, 2, ... one tied to it; all poses and
                              ///< covariances are since the first whichever it is
  bool has_tie_jump = false;  ///< the first keyframe was seen again: the next two are measured
  double tie_jump_um = 0;     ///< |by way of the tie - against the first| at the pivot
  double tie_jump_sigma = 0;  ///< the same in standard deviations, of all six freedoms
  StageTimes times;
};

}  // namespace holdfast::perception
