// SPDX-License-Identifier: Apache-2.0
// The ROS 2 mirror: which frames, poses and diagnostics are told, from what an observer heard
// (docs/ros2.md). The making of messages is pure; Ros2Outlet paces them. One thread.
#pragma once

#include <string>
#include <vector>

#include "bridge/live_view/live_picture.hpp"
#include "bridge/ros2/ros2_mirror.hpp"
#include "rt/outlets/live_poses.hpp"

namespace holdfast::outlets {

// REP-103 axes (x forward, y left, z up) unless the name says otherwise.
inline constexpr const char* kPatientFrame =
    "holdfast_patient";                                     ///< x anterior, y left, z superior
inline constexpr const char* kCtFrame = "holdfast_ct_lps";  ///< DICOM: left, posterior, superior
inline constexpr const char* kSiteFrame = "holdfast_site_optical";  ///< camera at the keyframe
inline constexpr const char* kOpticalFrame =
    "holdfast_camera_optical";  ///< x right, y down, z forward
inline constexpr const char* kCameraFrame = "holdfast_camera";

struct Ros2Settings {
  bool is_on = false;
  int domain = 42;      ///< where the ROS nodes are; not the daemon's
  std::string network;  ///< Cyclone XML or file URI; empty: the environment's
  std::string robot_frame = "holdfast_robot";
  double rate_hz = 50;      ///< of poses, at most
  bool has_images = false;  ///< there may be a live picture
};

/// robot -> patient.
[[nodiscard]] bridge::ros2::StampedTransform to_transform(const LivePose& pose,
                                                          const std::string& robot_frame);
/// The target with the patient's axes; the covariance is about it already.
[[nodiscard]] bridge::ros2::StampedPose to_pose(const LivePose& pose,
                                                const std::string& robot_frame);
/// ct -> site -> camera_optical: one tree, in which each frame has one parent.
[[nodiscard]] std::vector<bridge::ros2::StampedTransform> to_transforms(const LiveSite& site);
/// patient -> ct, camera_optical -> camera.
[[nodiscard]] std::vector<bridge::ros2::StampedTransform> static_transforms(nanoseconds t_utc);
/// Permission with its reason, tracking, registration; numbers only of what is heard.
[[nodiscard]] std::vector<bridge::ros2::Diagnostic> diagnostics(
    const observer::ObservedState& state, nanoseconds now);

/// In the camera's optical frame, at its exposure. Its pixels are the picture's.
[[nodiscard]] bridge::ros2::StampedImage to_ros_image(const bridge::LivePicture& picture);

class Ros2Outlet {
 public:
  /// Throws as Mirror.
  explicit Ros2Outlet(const Ros2Settings& settings);
  /// Publishes what is new and due.
  void tell(const observer::ObservedState& state, bridge::dds::Clocks now);
  /// A picture that is new; none: nothing.
  void tell_picture(const bridge::LivePicture* picture);

 private:
  void tell_diagnostics(const observer::ObservedState& state, bridge::dds::Clocks now);

  Ros2Settings settings_;
  bridge::ros2::Mirror mirror_;
  LiveFeed feed_;
  nanoseconds t_diagnostics_{};
  nanoseconds t_picture_{};  // exposure of the newest told
  std::string told_;         // what the newest diagnostics said of the permission
};

}  // namespace holdfast::outlets
