// SPDX-License-Identifier: Apache-2.0
// OpenIGTLink for 3D Slicer: transforms while they hold, and STATUS, which says so or why not
// (docs/ros2.md beside it). The making of messages is pure; IgtlOutlet paces them. One thread.
#pragma once

#include <optional>
#include <string>

#include "bridge/live_view/live_picture.hpp"
#include "bridge/openigtlink/igtl_messages.hpp"
#include "bridge/openigtlink/igtl_server.hpp"
#include "rt/outlets/live_poses.hpp"

namespace holdfast::outlets {

struct IgtlSettings {
  bool is_on = false;
  bridge::openigtlink::ServerParameters server;
  double rate_hz = 30;  ///< of transforms, at most
};

// Device names. Patient: the CT's coordinates as Slicer has them, RAS, mm.
inline constexpr const char* kStatusDevice = "Holdfast";
inline constexpr const char* kCameraToPatient = "CameraToPatient";
inline constexpr const char* kRobotToPatient = "RobotToPatient";
inline constexpr const char* kCameraImage = "CameraImage";

[[nodiscard]] bridge::openigtlink::Status to_status(const observer::ObservedState& state,
                                                    nanoseconds now);
[[nodiscard]] Eigen::Isometry3d T_patient_robot(const LivePose& pose);
[[nodiscard]] Eigen::Isometry3d T_patient_camera(const LiveSite& site);
/// In the camera's coordinates, upright on its axis where the site's depth was at the keyframe,
/// which must be known; the lens is taken as a pinhole. Its pixels are the picture's.
[[nodiscard]] bridge::openigtlink::Image to_igtl_image(const bridge::LivePicture& picture);

class IgtlOutlet {
 public:
  /// Throws as Server.
  explicit IgtlOutlet(const IgtlSettings& settings);
  /// Sends what is new and due.
  void tell(const observer::ObservedState& state, bridge::dds::Clocks now);
  /// A picture that is new; once, when there is none any more, a black one: a receiver keeps what
  /// it got last.
  void tell_picture(const bridge::LivePicture* picture, bridge::dds::Clocks now);
  [[nodiscard]] bridge::openigtlink::Server& server() noexcept { return server_; }

 private:
  void tell_status(const observer::ObservedState& state, bridge::dds::Clocks now);

  bridge::openigtlink::Server server_;
  LiveFeed feed_;
  nanoseconds t_status_{};
  std::string told_;                          // what the newest STATUS said
  std::optional<bridge::LivePicture> shown_;  // the newest picture told, while it is live
};

}  // namespace holdfast::outlets
