// SPDX-License-Identifier: Apache-2.0
// Every limit of the safety gate, with its default and its reason. Loaded once from the
// configuration (section [safety]), validated, then never changed.
#pragma once

#include <chrono>
#include <optional>
#include <string>

namespace holdfast::safety {

using Duration = std::chrono::nanoseconds;
/// An instant on CLOCK_MONOTONIC, as the duration since that clock's epoch.
using Timestamp = std::chrono::nanoseconds;

struct Limits {
  // Time
  Duration frame_period = std::chrono::microseconds(33'333);  ///< nominal, from the camera's rate
  Duration frame_lateness =
      std::chrono::milliseconds(8);  ///< a frame may be this late before a hold
  Duration estimate_age_max =
      std::chrono::milliseconds(90);  ///< exposure to now; bounds extrapolation
  Duration pose_validity = std::chrono::milliseconds(15);  ///< how long a robot may act on one pose
  /// A pose is for the instant so long after its cycle: what the robot itself takes from a pose to
  /// its beam. The uncertainty that this adds is in its covariance.
  Duration pose_lead{0};
  Duration robot_silence_max = std::chrono::milliseconds(100);
  Duration loop_lateness_max =
      std::chrono::milliseconds(5);  ///< wake-up later than this: loop_overrun
  Duration clock_step_max = std::chrono::milliseconds(2);  ///< UTC against monotonic, per cycle
  Duration frame_future_max =
      std::chrono::milliseconds(2);                    ///< an exposure stamp this far ahead of now
  Duration hold_max = std::chrono::milliseconds(500);  ///< a longer hold becomes a stop
  Duration hold_recovery =
      std::chrono::milliseconds(100);  ///< all must be well this long to leave a hold
  Duration confirm_min =
      std::chrono::milliseconds(200);  ///< between the two steps of acknowledgement
  Duration confirm_max = std::chrono::seconds(10);
  // Motion of the site
  double drift_max_mm = 0.3;          ///< frame-to-frame against keyframe-anchored, at the target
  double displacement_max_mm = 15.0;  ///< of the target since the keyframe
  double rotation_max_rad = 0.35;
  double speed_max_mm_per_s = 30.0;   ///< of the target
  double sigma_target_max_mm = 0.25;  ///< 1-sigma (largest axis) of the predicted target position
  // Optics against those of the registration
  double zoom_tolerance = 0.002;     ///< of the zoom as the encoder numbers it
  double focus_tolerance_mm = 0.2;   ///< of the working distance
  double scale_mismatch_max = 0.02;  ///< image's scale against the encoder's, relative
  Duration optics_age_max =
      std::chrono::milliseconds(50);  ///< since our reader last looked at the microscope
  // Evidence
  int inliers_min = 30;
  double inlier_spread_min = 0.15;  ///< fraction of image cells that hold an inlier, 0..1
};

/// The first limit that is out of its sensible range or contradicts another, in one line with
/// value, limit and unit; empty when all are usable. Not for the real-time path (allocates).
[[nodiscard]] std::optional<std::string> invalid_limit(const Limits& limits);

}  // namespace holdfast::safety
